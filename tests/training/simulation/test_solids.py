"""Solids of objects: pieces, weights, feet, symmetry and distances."""

import math
from collections import Counter

import numpy as np
import numpy.typing as npt
import pytest

from service.pushing.contexts import ObjectContext
from service.pushing.sides import CORE_HALF_WIDTH_M, RECTANGLE_DEPTH_M, Polygon
from training.omnipush.published import omnipush_descriptors
from training.simulation.solids import Solid, clearance_m, solid

CORE_AREA_M2 = 4.0 * CORE_HALF_WIDTH_M**2
UNIT_SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


def body_of(descriptor: str) -> Solid:
    """Return the solid of a descriptor."""
    return solid(ObjectContext.from_descriptor(descriptor))


def area_m2(piece: Polygon) -> float:
    """Compute the area by the shoelace formula, positive for counter-clockwise corners."""
    x, y = piece.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def quarter_turned(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Turn points (n, 2) by +90 degrees."""
    return np.column_stack([-points[:, 1], points[:, 0]])


def corner_sets(pieces: tuple[Polygon, ...]) -> Counter[frozenset[tuple[float, float]]]:
    """Return the pieces without their order and their first corner, in whole nanometres."""
    return Counter(frozenset((round(x, 9) + 0.0, round(y, 9) + 0.0) for x, y in piece) for piece in pieces)


@pytest.mark.parametrize(
    ("descriptor", "pieces", "weights"),
    [
        pytest.param("2a3a4a4a", 1 + 4, 0, id="plain sides are one piece each"),
        pytest.param("1a3a4a4a", 1 + 10 + 3, 0, id="a concave side is eight slabs and two horns"),
        pytest.param("1a1a1a1a", 1 + 4 * 10, 0, id="four concave sides"),
        pytest.param("2b3a4c4a", 1 + 4, 2, id="two weights"),
        pytest.param("2B2C4a4a", 1 + 4, 2, id="weights in the second position"),
    ],
)
def test_a_descriptor_gives_its_pieces_weights_and_feet(descriptor: str, pieces: int, weights: int) -> None:
    """A descriptor gives the core and its sides, a weight for every letter but a, and a foot per side and corner."""
    body = body_of(descriptor)

    assert (len(body.pieces), len(body.weights), len(body.feet_m)) == (pieces, weights, 8)


def test_weights_have_the_masses_of_their_letters() -> None:
    """Weights b and B are 60 g, c and C are 150 g."""
    masses = [weight.mass_kg for weight in body_of("2b2c2B2C").weights]

    assert masses == [0.060, 0.150, 0.060, 0.150]


def test_every_piece_is_convex_and_counter_clockwise() -> None:
    """Every piece of the 250 objects has only left turns and a positive area."""
    for descriptor in omnipush_descriptors():
        for piece in body_of(descriptor).pieces:
            edges = np.roll(piece, -1, axis=0) - piece
            following = np.roll(edges, -1, axis=0)
            turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
            assert (turns > 0.0).all(), descriptor
            assert area_m2(piece) > 0.0, descriptor


@pytest.mark.parametrize(
    ("shape", "side_area_m2", "relative"),
    [
        pytest.param("2", 0.5 * 0.058 * 0.040, 1e-9, id="triangle"),
        pytest.param("3", 0.5 * math.pi * 0.029**2, 0.005, id="half disc of 24 corners"),
        pytest.param("4", 0.058 * RECTANGLE_DEPTH_M, 1e-9, id="block"),
        # a circular segment, chord 50 mm, sagitta 14 mm: r = (25^2 + 14^2) / 28, area = r^2 (t - sin t) / 2
        pytest.param("1", 0.058 * 0.034 - 0.000493, 0.01, id="block less a bite of eight chords"),
    ],
)
def test_sides_have_the_areas_of_their_shapes(shape: str, side_area_m2: float, relative: float) -> None:
    """Pieces neither overlap nor leave gaps: their areas add up to the core and four times the side."""
    total = sum(area_m2(piece) for piece in body_of(f"{shape}a" * 4).pieces)

    assert (total - CORE_AREA_M2) / 4.0 == pytest.approx(side_area_m2, rel=relative)


@pytest.mark.parametrize("side", range(4), ids=["side 1 to +x", "side 2 to +y", "side 3 to -x", "side 4 to -y"])
def test_sides_face_the_axes_of_the_object_frame(side: int) -> None:
    """Side 1 faces +x, side 2 faces +y, side 3 faces -x and side 4 faces -y."""
    sides = ["3a"] * 4
    sides[side] = "3b"
    (weight,) = body_of("".join(sides)).weights

    direction = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[side]
    assert (weight.x_m, weight.y_m) == pytest.approx(tuple(math.hypot(weight.x_m, weight.y_m) * direction))


@pytest.mark.parametrize("quarter_turns", [1, 2, 3], ids=["quarter turn", "half turn", "three quarters"])
@pytest.mark.parametrize("descriptor", ["1a2b3c4a", "2B1a2C3a", "4c4a3a1b"])
def test_turning_a_solid_is_shifting_its_sides(descriptor: str, quarter_turns: int) -> None:
    """The solid of a turned context is the turned solid, with the same pieces, weights and feet."""
    context = ObjectContext.from_descriptor(descriptor)
    found, body = solid(context.turned(quarter_turns)), solid(context)
    pieces = body.pieces
    places = np.array([(weight.x_m, weight.y_m) for weight in body.weights])
    feet = np.array(body.feet_m)
    for _ in range(quarter_turns):
        pieces = tuple(quarter_turned(piece) for piece in pieces)
        places, feet = quarter_turned(places), quarter_turned(feet)

    turned_weights = {
        (round(x, 9), round(y, 9), weight.mass_kg) for (x, y), weight in zip(places, body.weights, strict=True)
    }
    assert corner_sets(found.pieces) == corner_sets(pieces)
    assert {(round(w.x_m, 9), round(w.y_m, 9), w.mass_kg) for w in found.weights} == turned_weights
    assert corner_sets((np.array(found.feet_m),)) == corner_sets((feet,))


@pytest.mark.parametrize(("inner", "outer"), [("b", "B"), ("c", "C")], ids=["60 g", "150 g"])
def test_second_position_is_further_out(inner: str, outer: str) -> None:
    """A weight B or C sits further from the centre than b or c on the same side, and is as heavy."""
    (near,) = body_of(f"2{inner}3a3a3a").weights
    (far,) = body_of(f"2{outer}3a3a3a").weights

    assert far.x_m > near.x_m
    assert far.mass_kg == near.mass_kg


def test_weights_and_feet_lie_inside_the_object() -> None:
    """The centre of every weight and every foot of all 250 objects is inside a piece or on a cut between two."""
    for descriptor in omnipush_descriptors():
        body = body_of(descriptor)
        points = np.array([*((weight.x_m, weight.y_m) for weight in body.weights), *body.feet_m])
        nearest = np.min([clearance_m(piece, points) for piece in body.pieces], axis=0)
        assert (nearest < 1e-9).all(), descriptor


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        pytest.param((3.0, 0.0), 2.0, id="outside an edge"),
        pytest.param((4.0, 5.0), 5.0, id="outside a corner: 3, 4, 5"),
        pytest.param((0.0, 0.0), -1.0, id="the middle"),
        pytest.param((0.75, 0.5), -0.25, id="inside, near an edge"),
        pytest.param((1.0, 0.3), 0.0, id="on an edge"),
        pytest.param((1.0, 1.0), 0.0, id="on a corner"),
        pytest.param((1.0, 2.5), 1.5, id="on the line of an edge, outside"),
    ],
)
def test_clearance_of_a_square(point: tuple[float, float], expected: float) -> None:
    """Clearance is the distance outside, minus the depth inside, and zero on the edge."""
    (found,) = clearance_m(UNIT_SQUARE, np.array([point]))

    assert found == pytest.approx(expected, abs=1e-12)


def test_clearance_changes_sign_across_every_edge() -> None:
    """A step of a micrometre outwards from an edge's middle is clear of the piece, a step inwards is not."""
    for piece in body_of("1a2a3a4a").pieces:
        edge = np.roll(piece, -1, axis=0) - piece
        middle = piece + edge / 2.0
        outwards = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.linalg.norm(edge, axis=1, keepdims=True)
        assert clearance_m(piece, middle + 1e-6 * outwards) == pytest.approx(1e-6, rel=1e-3)
        assert clearance_m(piece, middle - 1e-6 * outwards) == pytest.approx(-1e-6, rel=1e-3)
