"""Convex pieces of any simple polygon, for MuJoCo, which collides convex bodies only.

The polygon is cut into triangles by shapely's constrained Delaunay triangulation (GEOS), and triangles are merged while
they stay convex (S. Hertel, K. Mehlhorn, "Fast triangulation of the plane with respect to simple polygons", 1985: at
most four times the fewest pieces). The pieces cover the outline exactly, without a new corner. shapely is well kept,
has wheels for every platform and is wanted for outlines anyway. coacd approximates meshes in space, and its pieces
differ from the outline by its tolerance. manifold3d decomposes solids in space. mapbox-earcut triangulates as well, but
with more slivers, as it does not aim at Delaunay's angles.
"""

from typing import Final

import numpy as np
import shapely

from service.pushing.outlines import Outline
from training.simulation.surfaces import Array

_STRAIGHT: Final = 1e-12  # of the square of the extent: corners that turn right by less count as straight


def convex_pieces(outline: Outline) -> tuple[Array, ...]:
    """Return convex polygons (corners, 2), counter-clockwise, that together are the outline.

    A convex outline is one piece.
    """
    corners = outline.corners
    least = -_STRAIGHT * outline.extent_m**2
    rings = dict(enumerate(_triangles(corners)))
    owner = {edge: number for number, ring in rings.items() for edge in _edges(ring)}
    inner = [(start, end) for start, end in owner if start < end and (end, start) in owner]
    # long seams first, so that the pieces become compact
    for start, end in sorted(
        inner, key=lambda edge: (-float(np.linalg.norm(corners[edge[0]] - corners[edge[1]])), edge)
    ):
        one, other = owner[start, end], owner[end, start]
        ring = _merged(rings[one], rings[other], start, end)
        if all(_turn(corners, ring, corner) >= least for corner in (start, end)):
            rings[one] = ring
            del rings[other]
            owner.update(dict.fromkeys(_edges(ring), one))
    return tuple(corners[ring] for ring in rings.values())


def _triangles(corners: Array) -> list[list[int]]:
    """Return a triangulation of a polygon as counter-clockwise triples of numbers of its corners."""
    found = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(corners)))
    number = {(x, y): place for place, (x, y) in enumerate(corners.tolist())}
    return [
        [number[x, y] for x, y in shapely.get_coordinates(shapely.orient_polygons(part))[:3].tolist()] for part in found
    ]


def _edges(ring: list[int]) -> list[tuple[int, int]]:
    return list(zip(ring, [*ring[1:], ring[0]], strict=True))


def _merged(ring: list[int], other: list[int], start: int, end: int) -> list[int]:
    """Return the union of two rings that share an edge, from ``start`` to ``end`` in the first."""
    first, second = ring.index(end), other.index(start)
    around, back = ring[first:] + ring[:first], other[second:] + other[:second]
    return [*around, *back[1:-1]]


def _turn(corners: Array, ring: list[int], corner: int) -> float:
    """Return the cross product of the edges at a corner of a ring, positive for a left turn."""
    place = ring.index(corner)
    before, here, after = corners[ring[place - 1]], corners[corner], corners[ring[(place + 1) % len(ring)]]
    (ax, ay), (bx, by) = here - before, after - here
    return float(ax * by - ay * bx)
