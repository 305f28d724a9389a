"""Convex pieces: they cover any outline exactly, and a convex outline is one piece."""

import math

import mujoco
import numpy as np
import pytest
import shapely

from service.pushing.outlines import Outline
from training.simulation.pieces import convex_pieces
from training.simulation.scene import scene
from training.simulation.solids import Solid


def star(points: int, inner: float = 0.4) -> list[tuple[float, float]]:
    """Return a star of 50 mm."""
    radius = [0.05, 0.05 * inner] * points
    return [(r * math.cos(k * math.pi / points), r * math.sin(k * math.pi / points)) for k, r in enumerate(radius)]


OUTLINES = {
    "box": [(0.0, 0.0), (0.09, 0.0), (0.09, 0.04), (0.0, 0.04)],
    "512 corners": star(256, 1.0),
    "L": [(0.0, 0.0), (0.06, 0.0), (0.06, 0.02), (0.02, 0.02), (0.02, 0.08), (0.0, 0.08)],
    "U": [(0, 0), (0.08, 0), (0.08, 0.06), (0.06, 0.06), (0.06, 0.02), (0.02, 0.02), (0.02, 0.06), (0, 0.06)],
    "star": star(5),
    "star of 512 corners": star(256, 0.7),
    "thin bar": [(0.0, 0.0), (0.3, 0.0), (0.3, 0.0005), (0.0, 0.0005)],
    "thin bent bar": [(0, 0), (0.2, 0), (0.2, 0.1), (0.199, 0.1), (0.199, 0.001), (0, 0.001)],
    "straight corners": [(0, 0), (0.02, 0), (0.04, 0), (0.04, 0.02), (0.04, 0.04), (0.02, 0.04), (0, 0.04), (0, 0.02)],
    "far from the origin": [(1.0, 1.0), (1.06, 1.0), (1.06, 1.02), (1.02, 1.02), (1.02, 1.08), (1.0, 1.08)],
}


@pytest.mark.parametrize("name", OUTLINES)
def test_the_pieces_are_the_outline(name: str) -> None:
    """Pieces are convex and counter-clockwise, do not overlap, and together have the outline's area and shape."""
    outline = Outline.of(OUTLINES[name])
    pieces = convex_pieces(outline)
    polygons = [shapely.Polygon(piece) for piece in pieces]
    whole = shapely.Polygon(outline.corners)

    assert all(polygon.exterior.is_ccw for polygon in polygons)
    assert all(polygon.convex_hull.area == pytest.approx(polygon.area, rel=1e-9) for polygon in polygons)
    assert sum(polygon.area for polygon in polygons) == pytest.approx(whole.area, rel=1e-9)
    assert shapely.union_all(polygons).symmetric_difference(whole).area < 1e-9 * whole.area


@pytest.mark.parametrize(
    ("name", "count"), [("box", 1), ("512 corners", 1), ("straight corners", 1), ("L", 2), ("U", 3), ("thin bar", 1)]
)
def test_there_are_few_pieces(name: str, count: int) -> None:
    """A convex outline is one piece, an L is two, a U is three."""
    assert len(convex_pieces(Outline.of(OUTLINES[name]))) == count


def test_a_star_of_n_points_has_at_most_n_and_one_pieces() -> None:
    """The middle and a piece for each point, or fewer."""
    assert len(convex_pieces(Outline.of(star(5)))) <= 6


def test_the_pieces_do_not_depend_on_the_run() -> None:
    """The same outline gives the same bytes."""
    one, two = (convex_pieces(Outline.of(star(9))) for _ in range(2))

    assert [piece.tobytes() for piece in one] == [piece.tobytes() for piece in two]


@pytest.mark.parametrize("name", OUTLINES)
def test_mujoco_accepts_the_pieces(name: str) -> None:
    """Every piece becomes a mesh of the scene, slivers of half a millimetre included."""
    pieces = convex_pieces(Outline.of(OUTLINES[name]))
    model = scene(Solid(pieces, (), ((0.0, 0.0),))).compile()

    assert isinstance(model, mujoco.MjModel)
    assert model.nmesh == len(pieces)
    assert np.isfinite(model.body_mass).all()
