"""Mechanics in tensors agrees with the mechanics of the service, and keeps the laws of pushing."""

import math

import numpy as np
import pytest
import torch

from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import PUSHER_RADIUS_M, ShapeContext
from training.networks.mechanics import Mechanics, PushMechanics
from training.simulation.bodies import body, even_conditions
from training.simulation.pushing import push_body

OUTLINES = [
    [(0.06, 0.04), (-0.06, 0.04), (-0.06, -0.04), (0.06, -0.04)],
    [(0.055, -0.01), (-0.03, 0.045), (-0.035, -0.035)],
    [(0.14, 0.08), (0.14, 0.1), (0.1, 0.1), (0.1, 0.145), (0.075, 0.145), (0.075, 0.08)],  # away from the origin
    [(0.05 * math.cos(turn), 0.03 * math.sin(turn)) for turn in np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)],
]


def pushes_at(outline: Outline, count: int, seed: int = 0) -> DoubleArray:
    """Draw pushes (n, 4) from a circle around an outline, towards places near its centroid."""
    rng = np.random.default_rng(seed)
    bearing = rng.uniform(-math.pi, math.pi, count)
    away = 2.0 * outline.size_m
    start = outline.centroid_m + away * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    aim = outline.centroid_m + rng.uniform(-0.9, 0.9, (count, 2)) * outline.size_m - start
    length = rng.uniform(0.3, 2.5, count) * outline.size_m
    return np.column_stack([start, np.arctan2(aim[:, 1], aim[:, 0]), length])


def asked(context: ShapeContext, pushes: DoubleArray) -> Mechanics:
    """Return the mechanics of pushes of one object."""
    tensors = context.tensors()
    one = [torch.from_numpy(tensor[None]) for tensor in (tensors.outline, tensors.support, tensors.body)]
    index = torch.zeros(len(pushes), dtype=torch.int64)
    with torch.no_grad():
        found: Mechanics = PushMechanics()(torch.from_numpy(pushes.astype(np.float32)), *one, index)
    return found


def poses(found: Mechanics, outline: Outline, pushes: DoubleArray) -> DoubleArray:
    """Return the poses (n, 3) of objects in their own frame, as ``push`` gives them."""
    moved, yaw = found.motion.numpy()[:, :2] * outline.size_m, found.motion.numpy()[:, 2]
    turned = turned_by(moved, pushes[:, 2])
    centroid = np.broadcast_to(outline.centroid_m, turned.shape)
    return np.column_stack([centroid + turned - turned_by(centroid, yaw), yaw])


def turned_by(vectors: DoubleArray, angles: DoubleArray) -> DoubleArray:
    """Return vectors (n, 2) turned by angles (n,)."""
    cos, sin = np.cos(angles), np.sin(angles)
    return np.stack([cos * vectors[:, 0] - sin * vectors[:, 1], sin * vectors[:, 0] + cos * vectors[:, 1]], axis=1)


@pytest.mark.parametrize("corners", OUTLINES, ids=["box", "triangle", "L", "ellipse"])
def test_the_first_contact_is_exact(corners: list[tuple[float, float]]) -> None:
    """Touches, the rest of the push, the point and the normal are those of the closed form of the service."""
    outline = Outline.of(corners)
    pushes = pushes_at(outline, 300)
    found, expected = asked(ShapeContext(outline), pushes), first_contact(outline, pushes, PUSHER_RADIUS_M)
    touches = np.isfinite(expected.travel_m)
    assert 50 < touches.sum() < 300
    assert (found.touches.numpy() > 0.0).tolist() == touches.tolist()
    left, point, normal = (part.numpy()[touches] for part in (found.left, found.point, found.normal))
    assert left * outline.size_m == pytest.approx(pushes[touches, 3] - expected.travel_m[touches], abs=2e-7)
    angle = pushes[touches, 2]
    assert outline.centroid_m + turned_by(point * outline.size_m, angle) == pytest.approx(
        expected.point_m[touches], abs=3e-6
    )
    assert turned_by(normal, angle) == pytest.approx(expected.normal[touches], abs=2e-4)


@pytest.mark.parametrize("centre", [None, (0.01, 0.005)], ids=["centroid", "elsewhere"])
@pytest.mark.parametrize("corners", OUTLINES, ids=["box", "triangle", "L", "ellipse"])
def test_motions_are_those_of_the_simulation(
    corners: list[tuple[float, float]], centre: tuple[float, float] | None
) -> None:
    """Half of the motions are those of small steps to a hundredth of the object's size, and few are far off."""
    outline = Outline.of(corners)
    pushes = pushes_at(outline, 200, seed=1)
    place = None if centre is None else tuple(outline.centroid_m + np.array(centre))
    context = ShapeContext(outline, place, 0.35, 0.006)
    resting = body(outline, "even", np.random.default_rng(0), None if place is None else np.array(place))
    expected = push_body(resting, pushes, 0.006, even_conditions(resting, len(pushes), 0.35))
    difference = poses(asked(context, pushes), outline, pushes) - expected
    distance = np.hypot(difference[:, 0], difference[:, 1])
    assert distance.mean() < 0.08 * outline.size_m
    assert np.median(distance) < 0.01 * outline.size_m
    assert np.median(np.abs(np.degrees(difference[:, 2]))) < 0.6
    assert np.hypot(expected[:, 0], expected[:, 1]).mean() > 0.2 * outline.size_m


def test_a_push_that_misses_is_all_zero() -> None:
    """A push that passes by, ends before the object or leads away gives zeros, exactly."""
    pushes = np.array([[-0.2, 0.2, 0.0, 0.4], [-0.2, 0.0, 0.0, 0.1], [-0.2, 0.0, math.pi, 0.4]])
    found = asked(ShapeContext(Outline.of(OUTLINES[0])), pushes)
    assert all(part.abs().max() == 0.0 for part in found)


def test_a_tip_that_touches_at_the_start_pushes_at_once() -> None:
    """A tip in touch, or a little inside of the outline, has its whole push left, and moves the object ahead."""
    starts = [-0.06 - PUSHER_RADIUS_M, -0.06 - PUSHER_RADIUS_M - 1e-8, -0.06 - 0.5 * PUSHER_RADIUS_M, -0.0599]
    found = asked(ShapeContext(Outline.of(OUTLINES[0])), np.array([[x, 0.0, 0.0, 0.05] for x in starts]))
    size = Outline.of(OUTLINES[0]).size_m
    assert found.left.numpy() * size == pytest.approx(0.05, abs=1e-6)
    assert found.motion.numpy() == pytest.approx(np.array([[0.05 / size, 0.0, 0.0]] * 4), abs=1e-3)


def test_a_mirrored_push_has_the_mirrored_answer() -> None:
    """Mirrored at the line of the push, the object moves to the other side and turns the other way."""
    outline = Outline.of(OUTLINES[1])
    pushes = pushes_at(outline, 50)
    mirror = np.array([1.0, -1.0, -1.0])
    found = asked(ShapeContext(outline), pushes).motion.numpy()
    mirrored = asked(ShapeContext(Outline.of(np.array(OUTLINES[1]) * mirror[:2])), pushes * np.append(mirror, 1.0))
    assert mirrored.motion.numpy() == pytest.approx(found * mirror, abs=1e-4)


def test_mechanics_has_no_scale() -> None:
    """Twice the size, tip and push have the same answer in sizes."""
    outline = Outline.of(OUTLINES[3])
    pushes = pushes_at(outline, 50)
    found = asked(ShapeContext(outline, pusher_radius_m=0.005), pushes).motion.numpy()
    twice = ShapeContext(Outline.of(2.0 * np.array(OUTLINES[3])), pusher_radius_m=0.010)
    assert asked(twice, pushes * np.array([2.0, 2.0, 1.0, 2.0])).motion.numpy() == pytest.approx(found, abs=1e-4)


@pytest.mark.parametrize("length_m", [1e-6, 0.5, 5.0])
def test_motions_are_finite_for_any_length(length_m: float) -> None:
    """Pushes far longer than the object, which go through it step by step, still have numbers as answers."""
    outline = Outline.of(OUTLINES[2])
    pushes = pushes_at(outline, 100)
    pushes[:, 3] = length_m
    assert all(torch.isfinite(part).all() for part in asked(ShapeContext(outline), pushes))
