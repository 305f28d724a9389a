"""Hypotheses about an object: their tensors are those of the contexts that state them."""

import numpy as np
import pytest

from service.planning.bodies import Bodies
from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from tests.served_graphs import BOX, L_SHAPE

HYPOTHESES = np.array(
    [[0.0, 0.0, -1.6, 0.0, 0.0, 0.0], [0.2, -0.1, -1.2, 1.0, 0.3, -0.5], [-0.3, 0.1, -2.0, -1, 0, -1]]
)


@pytest.mark.parametrize("outline", [BOX, L_SHAPE])
def test_tensors_are_those_of_the_stated_contexts(outline: Outline) -> None:
    """All hypotheses at once give the numbers that a request with each of their contexts has."""
    centred = Outline.of(outline.corners - outline.centroid_m)
    bodies = Bodies(ShapeContext(centred, pusher_radius_m=0.006))
    found, possible = bodies.tensors(HYPOTHESES)
    assert possible.all()
    for row, hypothesis in enumerate(HYPOTHESES):
        for one, other in zip(found, bodies.context(hypothesis).tensors(), strict=True):
            assert one[row] == pytest.approx(other, abs=1e-6)


def test_a_context_keeps_what_is_known() -> None:
    """Outline and tip stay, and a hypothesis is written in metres from the origin of the caller's frame."""
    shape = ShapeContext(L_SHAPE, pusher_radius_m=0.006)
    bodies = Bodies(shape)
    found = bodies.context(np.array([0.5, 0.0, np.log(0.3), 1.0, 0.0, 1.0]))
    assert found.outline is shape.outline
    assert found.pusher_radius_m == 0.006
    assert found.centre_of_mass_m == pytest.approx(L_SHAPE.centroid_m + np.array([0.5 * L_SHAPE.size_m, 0.0]))
    assert found.friction == pytest.approx(0.3)
    assert found.pressure == (1.0, 0.0, 1.0)


def test_what_a_context_states_is_where_hypotheses_begin() -> None:
    """A context that was refined states the hypothesis that it came from."""
    bodies = Bodies(ShapeContext(L_SHAPE))
    assert Bodies(bodies.context(HYPOTHESES[1])).stated == pytest.approx(HYPOTHESES[1])
    assert bodies.stated[:2] == pytest.approx(np.zeros(2))


def test_a_hypothesis_that_no_context_could_state_is_not_possible() -> None:
    """A centre of mass outside of the points of support, and numbers out of range, are none."""
    wrong = np.zeros((4, 6))
    wrong[:, 2] = np.log(0.2)
    wrong[0, 0], wrong[1, 2], wrong[2, 4] = 5.0, np.log(3.0), 6.0
    assert Bodies(ShapeContext(BOX)).tensors(wrong)[1].tolist() == [False, False, False, True]


def test_a_context_states_the_nearest_possible_values() -> None:
    """A mean beside all bounds becomes a context that every request accepts."""
    far = np.array([9.0, -9.0, np.log(0.001), 6.0, -6.0, 0.0])
    found = Bodies(ShapeContext(BOX)).context(far)
    assert (found.centre_of_mass_m, found.friction, found.pressure) == ((0.06, -0.04), 0.01, (5.0, -5.0, 0.0))


def test_outcomes_move_to_the_centroid_with_their_turn() -> None:
    """An object that turns about its centroid moves nowhere in the centroid frame, wherever the caller's origin is."""
    yaw, origin = 0.4, np.array([0.3, -0.2])
    shape = ShapeContext(Outline.of(BOX.corners + origin))
    c, s = np.cos(yaw), np.sin(yaw)
    moved = origin - np.array([c * origin[0] - s * origin[1], s * origin[0] + c * origin[1]])
    pushes, outcomes = Bodies(shape).in_centroid_frame(np.array([[0.2, -0.2, 0.0, 0.05]]), np.array([[*moved, yaw]]))
    assert outcomes == pytest.approx(np.array([[0.0, 0.0, yaw]]), abs=1e-12)
    assert pushes == pytest.approx(np.array([[-0.1, 0.0, 0.0, 0.05]]))
