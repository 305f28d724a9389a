"""Pushes about an object, as three numbers."""

import math

import numpy as np
import pytest

from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import into_object_frame
from training.environments.around import GAP_M, LONGEST_TRAVEL_M, push_around

BOX = Outline.of([(-0.05, -0.03), (0.05, -0.03), (0.05, 0.03), (-0.05, 0.03)])
HOOK = Outline.of([(0, 0), (0.1, 0), (0.1, 0.1), (0.08, 0.1), (0.08, 0.02), (0, 0.02)])
TIP_M = 0.005


def test_zeros_name_half_a_travel_through_the_middle() -> None:
    """The push heads along the object's x axis from just before its left side, wherever the object lies."""
    assert push_around(BOX, np.zeros(3), TIP_M, np.zeros(3)) == pytest.approx(
        [-0.05 - TIP_M - GAP_M, 0.0, 0.0, GAP_M + LONGEST_TRAVEL_M / 2]
    )
    turned = push_around(BOX, np.array([1.0, 2.0, math.pi / 2]), TIP_M, np.zeros(3))
    assert turned == pytest.approx([1.0, 2.0 - 0.05 - TIP_M - GAP_M, math.pi / 2, GAP_M + LONGEST_TRAVEL_M / 2])


def test_the_numbers_are_heading_place_and_travel() -> None:
    """A quarter of a turn, the left edge, and the longest travel. Numbers beyond 1 count as 1."""
    push = push_around(BOX, np.zeros(3), TIP_M, np.array([0.5, 1.0, 7.0]))
    assert push[2:] == pytest.approx([math.pi / 2, GAP_M + LONGEST_TRAVEL_M])
    assert push[0] == pytest.approx(-0.05 - TIP_M, abs=1e-5)  # left of a tip that looks along y


@pytest.mark.parametrize("outline", [BOX, HOOK], ids=["box", "hook"])
def test_every_push_touches_and_starts_clear(outline: Outline) -> None:
    """All numbers name a push whose first contact is one gap from its start."""
    rng = np.random.default_rng(1)
    pose = np.array([0.3, -0.2, 2.0])
    for numbers in [*rng.uniform(-1.0, 1.0, (60, 3)), np.array([0.3, -1.0, 0.0]), np.array([-1.0, 1.0, 0.0])]:
        push = push_around(outline, pose, TIP_M, numbers)
        inside = np.append(into_object_frame(push[None, :3], pose[None])[0], push[3])
        assert first_contact(outline, inside[None], TIP_M).travel_m[0] == pytest.approx(GAP_M, abs=1e-6)
