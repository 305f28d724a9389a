"""Angles: wrapped to one turn, and continuous as cosine and sine."""

import math

import pytest
import torch

from training.networks.angles import circular, wrapped
from training.omnipush.published import published_normalisation


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(0.0, 0.0), (math.pi, math.pi), (-math.pi, math.pi), (4.0, 4.0 - 2.0 * math.pi), (-11.0, 4.0 * math.pi - 11.0)],
)
def test_angles_are_wrapped_into_one_turn(angle: float, expected: float) -> None:
    """Angles are wrapped to (-pi, pi], and -pi becomes pi."""
    found = float(wrapped(torch.tensor(angle, dtype=torch.float64)))

    assert found == pytest.approx(expected)


def test_a_circular_angle_is_its_cosine_and_sine() -> None:
    """A circular pose has cosine and sine of the angle in radians, and its position stays normalised."""
    known = published_normalisation()
    angle_rad = torch.linspace(-math.pi, math.pi, 7)
    normalised = (angle_rad - float(known.input_mean[2])) / float(known.input_std[2])
    pusher = torch.stack([torch.full((7,), 0.3), torch.full((7,), -1.2), normalised], dim=-1)
    found = circular(pusher)

    assert found.shape == (7, 4)
    assert torch.equal(found[:, :2], pusher[:, :2])
    assert torch.allclose(found[:, 2], torch.cos(angle_rad), atol=1e-6)
    assert torch.allclose(found[:, 3], torch.sin(angle_rad), atol=1e-6)
    assert torch.allclose(found[0], found[-1], atol=1e-6), "pi and -pi are one direction"
