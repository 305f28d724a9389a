"""Inputs of shape networks keep the symmetries of pushing: no unit of length, and no other turn than the object's."""

import math

import numpy as np
import pytest
import torch

from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from training.networks.mechanics import PushMechanics
from training.networks.shape_features import (
    CONTEXT_INPUTS,
    PUSH_INPUTS,
    RESIDUAL,
    context_inputs,
    push_inputs,
    residual_unit,
)

CORNERS = np.array([(0.055, -0.01), (-0.03, 0.045), (-0.035, -0.035)])
PUSHES = np.array([[-0.2, 0.005, 0.02, 0.2], [0.15, 0.1, -2.5, 0.25], [-0.2, 0.3, 0.0, 0.2]])


def inputs(
    corners: np.ndarray, pushes: np.ndarray, centre: tuple[float, float], tip_m: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the inputs of an object's context (1, 1032) and of its pushes (n, 22)."""
    found = ShapeContext(Outline.of(corners), centre, 0.25, tip_m).tensors()
    silhouette, outline, support, body = (torch.from_numpy(part[None]) for part in found)
    pusher, index = torch.from_numpy(pushes.astype(np.float32)), torch.zeros(len(pushes), dtype=torch.int64)
    with torch.no_grad():
        mechanics = PushMechanics()(pusher, outline, support, body, index)
        return context_inputs(silhouette, body), push_inputs(mechanics, pusher, body[index])


def test_inputs_have_the_sizes_that_networks_take() -> None:
    """Contexts are a silhouette and a body, and pushes are numbers of the contact and of the motion."""
    context, push = inputs(CORNERS, PUSHES, (0.0, 0.0), 0.005)
    assert context.shape == (1, CONTEXT_INPUTS)
    assert push.shape == (3, PUSH_INPUTS)


def test_inputs_have_no_unit_of_length() -> None:
    """Twice the object, the tip and the push have the same inputs."""
    once = inputs(CORNERS, PUSHES, (0.004, -0.002), 0.005)
    twice = inputs(2.0 * CORNERS, PUSHES * np.array([2.0, 2.0, 1.0, 2.0]), (0.008, -0.004), 0.010)
    for one, other in zip(once, twice, strict=True):
        torch.testing.assert_close(one, other, atol=2e-4, rtol=1e-3)


def test_inputs_do_not_depend_on_the_origin() -> None:
    """An object whose frame has its origin elsewhere has the same inputs."""
    away = np.array([0.03, -0.08])
    here = inputs(CORNERS, PUSHES, (0.004, -0.002), 0.005)
    there = inputs(CORNERS + away, PUSHES + np.array([*away, 0.0, 0.0]), (0.034, -0.082), 0.005)
    for one, other in zip(here, there, strict=True):
        torch.testing.assert_close(one, other, atol=5e-4, rtol=1e-3)


def test_the_unit_of_residuals_grows_with_the_rest_of_a_push() -> None:
    """It is a share of a short push, less of a long one, and above zero even where a push ends at the contact."""
    unit = residual_unit(torch.tensor([0.0, 0.1, 1.0, 10.0]))[:, 0].tolist()
    assert 0.0 < unit[0] < unit[1] < unit[2] < unit[3]
    assert unit[1] == pytest.approx(RESIDUAL * 0.1, rel=0.03)
    assert unit[3] < 10.0 * unit[2]
    assert math.isfinite(unit[3])
