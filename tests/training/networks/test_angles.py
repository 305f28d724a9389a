"""Angles: wrapped to one turn, and continuous as cosine and sine."""

import math

import numpy as np
import pytest
import torch

from training.networks.angles import circular, from_push_frame, in_push_frame, into_push_frame, wrapped
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


def normalised_pushers(rows: list[tuple[float, float, float]]) -> torch.Tensor:
    """Normalise pusher poses in m, m, rad."""
    known = published_normalisation()
    return torch.from_numpy((np.array(rows) - known.input_mean) / known.input_std).float()


def test_the_push_frame_tells_how_a_push_passes_the_centre() -> None:
    """The added features are the path to the point nearest to the centre, the signed aim, and the distance."""
    found = in_push_frame(
        normalised_pushers([(-0.08, 0.01, 0.0), (0.08, 0.0, 0.0), (0.0, 0.06, -0.5 * math.pi)])
    ) * float(published_normalisation().input_std[0])

    assert found[:, 4].tolist() == pytest.approx([0.08, -0.08, 0.06], abs=1e-6)
    assert found[:, 5].tolist() == pytest.approx([-0.01, 0.0, 0.0], abs=1e-6)
    assert found[:, 6].tolist() == pytest.approx([math.hypot(0.08, 0.01), 0.08, 0.06], abs=1e-6)


def test_a_mean_of_zero_in_the_push_frame_is_rest() -> None:
    """Zero in the frame of any push is an object that stays, and a motion along the push follows its direction."""
    known = published_normalisation()
    pusher = normalised_pushers([(-0.08, 0.01, 0.0), (0.0, 0.06, -0.5 * math.pi)])
    rest, moved = (
        from_push_frame(mean, pusher).double().numpy() * known.output_std + known.output_mean
        for mean in (torch.zeros(2, 3), torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3))
    )

    unit_m = known.output_std[0]
    assert rest == pytest.approx(np.zeros((2, 3)), abs=1e-7)
    assert moved == pytest.approx(np.array([[unit_m, 0.0, 0.0], [0.0, -unit_m, 0.0]]), abs=1e-7)


def test_an_outcome_goes_into_the_push_frame_and_back() -> None:
    """Outcomes in their own push frames are those that the way back turns into the same poses. Rest is 0."""
    known, generator = published_normalisation(), torch.Generator().manual_seed(2)
    pushers, outcomes = torch.randn(2, 4, 5, 3, generator=generator)
    found = into_push_frame(outcomes, pushers)
    rest = torch.from_numpy(-known.output_mean / known.output_std).float().expand_as(outcomes)

    assert torch.allclose(from_push_frame(found, pushers), outcomes, atol=1e-5)
    assert torch.allclose(into_push_frame(rest, pushers), torch.zeros_like(rest), atol=1e-6)


def test_an_object_that_is_pushed_along_moves_along_the_first_axis() -> None:
    """An outcome of 10 mm in the direction of the push has its millimetres on the first axis of the push frame."""
    known = published_normalisation()
    along = (np.array([[0.0, -0.01, 0.2]]) - known.output_mean) / known.output_std
    found = into_push_frame(torch.from_numpy(along).float(), normalised_pushers([(0.0, 0.08, -math.pi / 2.0)]))

    assert found[0].tolist() == pytest.approx([0.01 / known.output_std[0], 0.0, 0.2 / known.output_std[2]], abs=1e-4)
