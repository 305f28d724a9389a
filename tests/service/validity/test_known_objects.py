"""Known objects: their bounds hold, and any view gives one."""

import numpy as np
import pytest

from service.pushing.contexts import SHAPE_DIGITS, ObjectContext
from service.pushing.sides import outline_of_shapes
from service.validity.known_objects import omnipush_object, shape_keys, viewed_object, weight_counts


@pytest.mark.parametrize("digit", SHAPE_DIGITS)
def test_bounds_of_a_side_hold_on_every_side(digit: str) -> None:
    """Every disc lies inside of the outline, and no corner is beyond the reach or the half width."""
    for place in range(4):
        digits = "".join(digit if side == place else "4" for side in range(4))
        key = sum(SHAPE_DIGITS.index(each) * len(SHAPE_DIGITS) ** side for side, each in enumerate(digits))
        known, exact = omnipush_object(key), outline_of_shapes(digits)
        centres = np.array([disc[:2] for disc in known.discs])
        radii = np.array([disc[2] for disc in known.discs])
        assert (-exact.distance_m(centres) >= radii - 1e-9).all()
        right, top, left, bottom = known.reach_m
        low, high = exact.corners.min(axis=0), exact.corners.max(axis=0)
        assert (high <= np.array([right, top]) + 1e-9).all()
        assert (-low <= np.array([left, bottom]) + 1e-9).all()
        assert (np.abs(exact.corners).min(axis=1) <= known.half_width_m + 1e-9).all()


def test_keys_are_of_shapes_and_counts_of_weights() -> None:
    """Weights do not change the form of an object, and shapes not the number of weights."""
    first, second, third = (ObjectContext.from_descriptor(text) for text in ("1a2b3c4a", "1c2a3a4b", "4a4a4a4a"))
    tensors = np.stack([each.tensor() for each in (first, second, third)])
    keys = shape_keys(tensors).tolist()
    assert keys[0] == keys[1] != keys[2]
    assert weight_counts(tensors).tolist() == [2, 2, 0]


@pytest.mark.parametrize("name", ["black", "white", "noise", "a cell", "half"])
def test_any_view_gives_an_object_that_can_be_judged(name: str) -> None:
    """No view raises, and distances are numbers."""
    grey = np.zeros((32, 32), dtype=np.float32)
    if name == "white":
        grey[:] = 1.0
    elif name == "noise":
        grey[:] = np.random.default_rng(2).random((32, 32))
    elif name == "a cell":
        grey[16, 16] = 1.0
    elif name == "half":
        grey[:, :16] = 1.0
    known = viewed_object(grey.tobytes())
    pushers = np.array([[-0.08, 0.0, 0.0, 0.05], [0.0, 0.0, 1.0, 0.05], [9.0, 9.0, 1.0, 0.05]])
    assert known.form.misses(pushers, 0.005).shape == (3,)
    assert not np.isnan(known.form.distance_m(pushers[:, :2])).any()
    assert known.form.misses(pushers, 0.005)[2]
