"""Contact: the bounds that settle most pushes agree with the exact form, for every shape of side."""

import numpy as np
import pytest

from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.first_contact import first_contact
from service.pushing.images import GreyImage, visual_context
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import PUSHER_RADIUS_M
from service.pushing.sides import outline
from service.validity.contact import OVERLAP_M, contact, is_plain_contact
from service.validity.known_objects import KnownObject, omnipush_object, shape_keys, viewed_object
from training.simulation.drawing import top_down_view

DESCRIPTORS = ("1a2b3c4a", "4a4a4a4a", "2B1c3a2a", "3c3a3a3b", "1a1a1a1a")


def pushes_around(count: int) -> DoubleArray:
    """Return pushes (n, 4) that start all around an object or in it, of any direction and length."""
    rng = np.random.default_rng(3)
    bearing, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.02, 0.12, count)
    aim = bearing + np.pi + rng.normal(0.0, 0.7, count)
    x, y = distance * np.cos(bearing), distance * np.sin(bearing)
    return np.column_stack([x, y, aim, rng.uniform(0.01, 0.1, count)])


def known(context: ObjectContext) -> KnownObject:
    """Return the known object of a descriptor."""
    return omnipush_object(int(shape_keys(context.tensor()[None])[0]))


@pytest.mark.parametrize("descriptor", DESCRIPTORS)
def test_contact_by_descriptor_is_that_of_the_outline(descriptor: str) -> None:
    """A push misses, or starts inside, exactly if the object's outline says so."""
    context = ObjectContext.from_descriptor(descriptor)
    pushers, exact = pushes_around(3000), outline(context)
    misses, inside = contact(known(context), pushers, PUSHER_RADIUS_M)
    depth = exact.distance_m(pushers[:, :2])
    assert np.array_equal(inside, depth < PUSHER_RADIUS_M - OVERLAP_M)
    expected = np.isinf(first_contact(exact, pushers, PUSHER_RADIUS_M).travel_m)
    assert np.array_equal(misses, expected & ~inside)
    assert 100 < misses.sum() < 2900
    assert inside.any()


@pytest.mark.parametrize("descriptor", DESCRIPTORS)
def test_a_push_is_plain_only_if_it_touches_from_outside(descriptor: str) -> None:
    """The bounds never pass a push that misses or starts inside, and they pass most of the others."""
    this = known(ObjectContext.from_descriptor(descriptor))
    pushers = pushes_around(3000)
    misses, inside = contact(this, pushers, PUSHER_RADIUS_M)
    plain = np.array([is_plain_contact(this, x, y, aim, long, PUSHER_RADIUS_M) for x, y, aim, long in pushers.tolist()])
    assert not (plain & (misses | inside)).any()
    assert plain.sum() > 0.6 * (~misses & ~inside).sum()


@pytest.mark.parametrize("descriptor", DESCRIPTORS)
def test_contact_in_a_view_is_that_of_the_outline_within_millimetres(descriptor: str) -> None:
    """By its view, a push that misses by 5 mm is told to miss, and one that cuts into the object by 3 mm is not."""
    context = ObjectContext.from_descriptor(descriptor)
    pushers, exact = pushes_around(2000), outline(context)
    view = VisualContext(top_down_levels(context))
    misses, _ = contact(viewed_object(view.tensor().tobytes()), pushers, PUSHER_RADIUS_M)
    far = np.isinf(first_contact(exact, pushers, PUSHER_RADIUS_M + 0.005).travel_m)
    near = np.isfinite(first_contact(exact, pushers, PUSHER_RADIUS_M - 0.003).travel_m)
    assert misses[far & (exact.distance_m(pushers[:, :2]) > 0.01)].all()
    assert not misses[near].any()


def top_down_levels(context: ObjectContext) -> bytes:
    """Return the grey levels of the drawing of an object."""
    return visual_context(GreyImage(top_down_view(context))).levels
