"""Outlines: validation of polygons, and their geometry beside shapely's."""

import math

import numpy as np
import numpy.typing as npt
import pytest
import shapely

from service.errors import InvalidRequestError
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

SQUARE = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]
L_SHAPE = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.03], [0.03, 0.03], [0.03, 0.08], [0.0, 0.08]]
TRIANGLE = [[0.045, 0.045], [-0.0809, 0.045], [0.045, -0.08087]]


def star(corners: int, seed: int) -> DoubleArray:
    """Return a random star-shaped polygon (corners, 2) away from the origin."""
    rng = np.random.default_rng(seed)
    angle = (np.arange(corners) + 0.9 * rng.random(corners)) * 2.0 * math.pi / corners
    radius = rng.uniform(0.02, 0.09, corners)
    return np.column_stack([radius * np.cos(angle) + 0.3, radius * np.sin(angle) - 0.2])


SHAPES: dict[str, npt.ArrayLike] = {
    "square": SQUARE,
    "L": L_SHAPE,
    "triangle": TRIANGLE,
    "star": star(17, 0),
    "512 corners": star(512, 1),
}
any_shape = pytest.mark.parametrize("corners", SHAPES.values(), ids=SHAPES.keys())


@any_shape
def test_area_centroid_and_size_are_those_of_the_polygon(corners: npt.ArrayLike) -> None:
    """Area and centroid are those of shapely, and the size is the root mean square radius of a fine grid."""
    outline, polygon = Outline.of(corners), shapely.Polygon(np.array(corners))
    assert outline.area_m2 == pytest.approx(polygon.area, rel=1e-12)
    assert outline.centroid_m == pytest.approx((polygon.centroid.x, polygon.centroid.y), abs=1e-12)
    points = outline.samples(outline.extent_m / 400)
    assert outline.size_m == pytest.approx(np.sqrt(((points - outline.centroid_m) ** 2).sum(axis=1).mean()), rel=5e-3)
    assert outline.extent_m == pytest.approx(max(math.dist(p, q) for p in outline.corners for q in outline.corners))


@any_shape
def test_distances_are_those_of_the_polygon(corners: npt.ArrayLike) -> None:
    """The distance of points all around is that of shapely, negative inside, and leads to a point on it."""
    outline, polygon = Outline.of(corners), shapely.Polygon(np.array(corners))
    points = np.random.default_rng(3).uniform(-0.2, 0.2, (600, 2)) + outline.centroid_m
    inside = shapely.contains_xy(polygon, points)
    boundary = shapely.distance(polygon.exterior, shapely.points(points))
    assert 0 < inside.sum() < 600
    assert (outline.contains(points) == inside).all()
    assert outline.distance_m(points) == pytest.approx(np.where(inside, -boundary, boundary), abs=1e-12)
    nearest = outline.nearest(points)
    assert shapely.distance(polygon.exterior, shapely.points(nearest.point_m)).max() < 1e-12
    assert points + nearest.distance_m[:, None] * nearest.normal == pytest.approx(nearest.point_m, abs=1e-12)


def test_a_point_on_the_boundary_has_the_normal_of_its_edge() -> None:
    """Normals point into the object: at a corner they depend on the point, on an edge and inside they do not."""
    nearest = Outline.of(SQUARE).nearest(np.array([[0.05, 0.0], [0.05, -0.01], [0.05, 0.01], [-0.03, -0.04]]))
    assert nearest.normal == pytest.approx(np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.6, 0.8]]))
    assert nearest.distance_m == pytest.approx(np.array([0.0, 0.01, -0.01, 0.05]))


def test_many_points_in_chunks_are_the_same_as_one_by_one() -> None:
    """A distance does not depend on the number of points that are asked for at once."""
    outline = Outline.of(star(512, 1))
    points = np.random.default_rng(4).uniform(-0.2, 0.2, (1000, 2)) + outline.centroid_m
    at_once = outline.distance_m(points)
    assert (at_once[::99] == [outline.distance_m(point[None])[0] for point in points[::99]]).all()
    assert outline.distance_m(np.empty((0, 2))).shape == (0,)


def test_either_orientation_is_the_same_outline() -> None:
    """Corners are stored counter-clockwise, however they were given, and cannot be written to."""
    forward, backward = Outline.of(L_SHAPE), Outline.of(L_SHAPE[::-1])
    assert forward.area_m2 == backward.area_m2 > 0.0
    assert forward.corners.tolist() == backward.corners.tolist() == L_SHAPE
    with pytest.raises(ValueError, match="read-only"):
        forward.corners[0, 0] = 1.0


def test_an_even_grid_lies_inside_and_covers_the_area() -> None:
    """The samples of a symmetric outline are symmetric, and their number times a cell is about the area."""
    points = Outline.of(SQUARE).samples(0.01)
    assert len(points) == 100
    assert points.mean(axis=0) == pytest.approx([0.05, 0.05])
    outline = Outline.of(star(17, 0))
    assert len(outline.samples(0.001)) * 1e-6 == pytest.approx(outline.area_m2, rel=0.02)
    with pytest.raises(ValueError, match="wider"):
        outline.samples(1e-6)


TURNED = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
FAULTS: dict[str, tuple[npt.ArrayLike, str, str]] = {
    "no corner": ([], "outline", "0 corners"),
    "two corners": (SQUARE[:2], "outline", "2 corners"),
    "513 corners": (star(513, 1), "outline", "513 corners"),
    "a number": (3.0, "outline", "0 corners"),
    "triples": ([[*corner, 0.0] for corner in SQUARE], "outline", "not pairs"),
    "ragged": ([[0.0, 0.0], [0.1], [0.1, 0.1]], "outline", "not pairs"),
    "text": ([["0", "0"], ["1", "0"], ["1", "1"]], "outline", "not pairs"),
    "a huge integer": ([[0, 0], [10**400, 0], [1, 1]], "outline", "not pairs"),
    "NaN": ([[0.0, 0.0], [0.1, math.nan], [0.1, 0.1]], "outline.1", "nan"),
    "infinity": ([[0.0, 0.0], [0.1, 0.0], [math.inf, 0.1]], "outline.2", "inf"),
    "beyond the world": ([[0.0, 0.0], [1e300, 0.0], [0.0, 0.1]], "outline.1", "1e\\+300"),
    "millimetres": (np.array(SQUARE) * 1000.0, "outline", "141.4 m across.*millimetres"),
    "tiny": (np.array(SQUARE) / 100.0, "outline", "0.001414 m across"),
    "closed": ([*SQUARE, SQUARE[0]], "outline.4", "same point as corner 0.*again at the end"),
    "repeated": ([SQUARE[0], SQUARE[1], SQUARE[1], SQUARE[2]], "outline.2", "same point as corner 1"),
    "figure of eight": ([SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]], "outline", "edges 0 and 2"),
    "on a line": (np.array([[0.0, 0.0], [0.1, 0.0], [0.03, 0.0]]) @ TURNED + 5.0, "outline", "one line"),
    "a spike": ([*SQUARE, [0.0, 0.2]], "outline", "edges 3 and 4"),
    "a corner on another edge": ([*SQUARE[:2], [0.1, 0.05], [0.0, 0.05], [0.05, 0.0]], "outline", "touch"),
}


@pytest.mark.parametrize(("corners", "where", "received"), FAULTS.values(), ids=FAULTS.keys())
def test_a_faulty_outline_is_refused_with_field_and_cure(corners: npt.ArrayLike, where: str, received: str) -> None:
    """An outline with a fault is refused with the field, the fault and the form that is accepted."""
    with pytest.raises(InvalidRequestError, match=received) as caught:
        Outline.of(corners)
    (fault,) = caught.value.faults
    assert fault.where == where
    assert fault.accepted


def test_a_field_of_another_name_is_named() -> None:
    """The field of the request stands in the message."""
    with pytest.raises(InvalidRequestError, match=r"body\.contexts\.0\.outline\.3"):
        Outline.of([*SQUARE[:3], [math.nan, 0.1]], "body.contexts.0.outline")


def test_corners_along_a_straight_edge_are_no_fault() -> None:
    """A corner in the middle of an edge, a thin bar and corners far from the origin are accepted."""
    assert Outline.of([*SQUARE[:1], [0.05, 0.0], *SQUARE[1:]]).area_m2 == pytest.approx(0.01)
    assert Outline.of(np.array(SQUARE) * [1.0, 0.01] + 1000.0).area_m2 == pytest.approx(1e-4)


def test_points_along_an_outline_are_at_even_distances_with_their_inward_normals() -> None:
    """Shares of the way around lead from the first corner over every edge, and beyond a whole turn from the start."""
    box = Outline.of([[0.0, 0.0], [0.3, 0.0], [0.3, 0.1], [0.0, 0.1]])
    assert box.perimeter_m == pytest.approx(0.8)
    points, normals = box.along(np.array([0.0, 0.125, 0.4375, 0.5625, 0.9375, 1.125]))
    assert points == pytest.approx(
        np.array([[0.0, 0.0], [0.1, 0.0], [0.3, 0.05], [0.25, 0.1], [0.0, 0.05], [0.1, 0.0]])
    )
    assert normals == pytest.approx(np.array([[0, 1], [0, 1], [-1, 0], [0, -1], [1, 0], [0, 1]]))
