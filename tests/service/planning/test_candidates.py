"""Candidates of pushes: clear of the object, on its outline, with lengths that are allowed."""

import numpy as np
import pytest

from service.planning.candidates import LEAST_GAP_M, WIDEST_RAD, Pusher
from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from tests.service.planning.boxes import BOX, RADIUS_M, Mechanics

LENGTHS_M = np.array([0.02, 0.05])
U = Outline.of([[-0.05, 0.05], [-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [0.02, 0.05], [0.02, 0.0], [-0.02, 0.0], [-0.02, 0.05]])  # fmt: skip # noqa: E501


def go_on() -> bool:
    """Return False: the time is not over."""
    return False


def test_candidates_start_clear_of_the_object_and_meet_it() -> None:
    """Every tip starts at least the gap away from a box, touches it, and has one of the lengths."""
    pusher = Pusher(Mechanics(), BOX, RADIUS_M, LENGTHS_M)
    found = pusher.candidates(pusher.spread(200), go_on)
    assert len(found.pushes) > 180
    assert BOX.distance_m(found.pushes[:, :2]).min() >= RADIUS_M + LEAST_GAP_M - 1e-9
    assert np.isfinite(first_contact(BOX, found.pushes, RADIUS_M).travel_m).all()
    assert set(found.pushes[:, 3].tolist()) == {0.02, 0.05}


def test_the_rest_of_a_length_is_the_gap_before_the_object() -> None:
    """A straight push in the middle of a side travels as far in contact as it was asked to."""
    pusher = Pusher(Mechanics(), BOX, RADIUS_M, LENGTHS_M)
    found = pusher.candidates(np.array([[0.15, 0.0, 0.005], [0.15, 0.0, 0.03]]), go_on)
    gaps = first_contact(BOX, found.pushes, RADIUS_M).travel_m
    assert found.pushes[:, 3].tolist() == [0.02, 0.05]
    assert found.pushes[:, 3] - gaps == pytest.approx([0.005, 0.03])


def test_any_number_of_candidates_covers_the_object() -> None:
    """The first hundred parameters reach every tenth of the outline, and both ends of angle and travel."""
    along, angle, travel = Pusher(Mechanics(), BOX, RADIUS_M, LENGTHS_M).spread(100).T
    assert np.bincount((10 * along).astype(int), minlength=10).min() >= 8
    assert angle.min() < -0.9 * WIDEST_RAD < 0.9 * WIDEST_RAD < angle.max()
    assert travel.min() < 0.005 < 0.045 < travel.max() <= 0.05 - LEAST_GAP_M


def test_tips_that_do_not_fit_into_a_notch_are_left_out() -> None:
    """No tip starts inside of a U, and none in its notch, which is narrower than a tip with its gap."""
    pusher = Pusher(Mechanics(U), U, 0.018, LENGTHS_M)
    found = pusher.candidates(pusher.spread(300), go_on)
    assert 0 < len(found.pushes) < 300
    assert U.distance_m(found.pushes[:, :2]).min() >= 0.018


def test_unfamiliar_pushes_are_left_out_unless_there_are_no_others() -> None:
    """A model that vouches for short pushes gets those, and one that vouches for none gets all."""
    some = Pusher(Mechanics(unfamiliar_over_m=0.03), BOX, RADIUS_M, LENGTHS_M)
    assert set(some.candidates(some.spread(50), go_on).pushes[:, 3].tolist()) == {0.02}
    none = Pusher(Mechanics(unfamiliar_over_m=0.0), BOX, RADIUS_M, LENGTHS_M)
    assert len(none.candidates(none.spread(50), go_on).pushes) > 40


def test_predictions_end_with_the_time_after_the_first_part() -> None:
    """A clock that is over from the start leaves one part of the candidates."""
    model = Mechanics()
    pusher = Pusher(model, BOX, RADIUS_M, LENGTHS_M)
    found = pusher.candidates(pusher.spread(600), lambda: True)
    assert model.rows == [256]
    assert 0 < len(found.pushes) <= 256


def test_lengths_that_are_shorter_than_the_least_travel_are_used_as_far_as_they_go() -> None:
    """A length of 4 mm leaves 1 mm in contact."""
    pusher = Pusher(Mechanics(), BOX, RADIUS_M, np.array([0.004]))
    found = pusher.candidates(pusher.spread(20), go_on)
    assert found.parameters[:, 2] == pytest.approx(np.full(len(found.parameters), 0.001))
