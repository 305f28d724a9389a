"""Tests of shape contexts."""

import numpy as np
import pytest

from service.model.tensors import ContextKind
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import BODY, CORNERS, SILHOUETTE_SIZE, ShapeContext, reduced, silhouette
from service.pushing.support import MOST_POINTS

BOX = ((0.0, 0.0), (0.12, 0.0), (0.12, 0.08), (0.0, 0.08))


def _circle(corners: int) -> DoubleArray:
    """Return the corners of a regular polygon."""
    bearing = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return 0.05 * np.column_stack([np.cos(bearing), np.sin(bearing)])


def test_the_tensors_have_fixed_shapes_for_any_number_of_corners() -> None:
    """Every outline gives tensors of the same shapes and type."""
    for corners in (_circle(3), _circle(CORNERS), _circle(512)):
        found = ShapeContext(Outline.of(corners)).tensors()
        assert [tensor.shape for tensor in found] == [
            (1, SILHOUETTE_SIZE, SILHOUETTE_SIZE),
            (CORNERS, 2),
            (MOST_POINTS, 3),
            (len(BODY),),
        ]
        assert {tensor.dtype for tensor in found} == {np.dtype(np.float32)}
        assert np.isfinite(np.concatenate([tensor.ravel() for tensor in found])).all()


def test_an_unknown_body_has_its_defaults_and_says_so() -> None:
    """Without knowledge of the body, the centre of mass is the centroid, and the flags are 0."""
    body = dict(zip(BODY, ShapeContext(Outline.of(BOX)).tensors().body.tolist(), strict=True))
    assert (body["centre_of_mass_x"], body["centre_of_mass_y"]) == pytest.approx((0.06, 0.04))
    assert body["centre_of_mass_is_known"] == body["friction_is_known"] == body["pusher_radius_is_known"] == 0.0
    assert (body["friction"], body["pusher_radius"]) == pytest.approx((0.20, 0.00475))


def test_a_known_body_is_passed_on() -> None:
    """Known values are in the tensor, with their flags."""
    found = ShapeContext(Outline.of(BOX), (0.05, 0.03), 0.4, 0.01)
    assert found.kind is ContextKind.SHAPE
    body = dict(zip(BODY, found.tensors().body.tolist(), strict=True))
    assert (body["centre_of_mass_x"], body["friction"], body["pusher_radius"]) == pytest.approx((0.05, 0.4, 0.01))
    assert body["centre_of_mass_is_known"] == body["friction_is_known"] == body["pusher_radius_is_known"] == 1.0


def test_the_silhouette_does_not_depend_on_size_and_origin() -> None:
    """An object twice as large, anywhere, has the same silhouette."""
    one = silhouette(Outline.of(BOX))
    other = silhouette(Outline.of(2.0 * np.array(BOX) + (3.0, -1.0)))
    assert np.abs(one - other).max() < 1e-5
    assert one[0, 16, 16] < 0.0 < one[0, 0, 0]


def test_a_reduced_outline_keeps_the_corners_that_matter() -> None:
    """Corners in the middle of straight edges are dropped first."""
    dense = np.concatenate([np.linspace(BOX[side], BOX[(side + 1) % 4], 30, endpoint=False) for side in range(4)])
    assert sorted(map(tuple, reduced(dense, 4).round(9).tolist())) == sorted(BOX)
    assert len(reduced(_circle(512), CORNERS)) == CORNERS


def test_pressure_changes_the_support_alone() -> None:
    """A pressure that is even gives the tensors of an unknown one, and another one moves shares only."""
    unknown, even, rim = (
        ShapeContext(Outline.of(BOX), pressure=pressure).tensors()
        for pressure in (None, (0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    )
    for one, other in zip(unknown, even, strict=True):
        assert one.tobytes() == other.tobytes()
    assert np.abs(rim.support[:, 2] - even.support[:, 2]).max() > 0.01
    assert rim.support[:, :2].tobytes() == even.support[:, :2].tobytes()
    assert rim.body.tobytes() == even.body.tobytes()


def test_a_centre_of_mass_that_is_not_sure_is_passed_on_as_unknown() -> None:
    """Its place is in the tensor, and its flag is 0."""
    body = ShapeContext(Outline.of(BOX), (0.05, 0.03), centre_is_sure=False).tensors().body
    assert body[BODY.index("centre_of_mass_x")] == pytest.approx(0.05)
    assert body[BODY.index("centre_of_mass_is_known")] == 0.0
