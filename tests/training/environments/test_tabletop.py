"""The table in MuJoCo: pushes of any outline and length in the world."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from service.errors import InvalidRequestError
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, into_object_frame
from training.environments.tabletop import Tabletop
from training.shapes.outlines import draw_outline
from training.simulation.approach import draw_pushers
from training.simulation.bodies import RECORDED, body, even_conditions
from training.simulation.pushing import push_body
from training.simulation.scene import PUSHER_RADIUS_M

BOX = Outline.of([(-0.05, -0.03), (0.05, -0.03), (0.05, 0.03), (-0.05, 0.03)])
EVEN = replace(RECORDED, pressures=("even",), roughness=0.0, contact_spread=0.0)
GAP_M = 0.02
LEFT = (-0.05 - PUSHER_RADIUS_M - GAP_M, 0.0, 0.0)  # a start beside the box, towards its middle


@pytest.mark.parametrize("length_m", [0.021, 0.05, 0.12])
def test_a_push_through_the_middle_moves_the_object_by_its_length_less_the_gap(length_m: float) -> None:
    """An even box goes straight, by pushes of any length."""
    table = Tabletop(BOX, physics=EVEN)
    pose = table.push((*LEFT, length_m))

    assert pose == pytest.approx([length_m - GAP_M, 0.0, 0.0], abs=0.0005)
    assert table.pose == pytest.approx(pose, abs=0.0)


def test_a_push_is_given_in_the_world() -> None:
    """The same push of an object that lies elsewhere, turned, moves it by the same in its own frame."""
    pushes = np.array([(-0.08, 0.02, 0.1, 0.06)])
    here = Tabletop(BOX, physics=EVEN).push(pushes[0])
    lying = np.array([0.4, -0.3, 2.5])
    cos, sin = math.cos(2.5), math.sin(2.5)
    x, y = -0.08, 0.02
    there = Tabletop(BOX, lying, physics=EVEN).push((0.4 + cos * x - sin * y, -0.3 + sin * x + cos * y, 2.6, 0.06))

    assert abs(here[2]) > 0.1
    assert into_object_frame(there[None], lying[None])[0] == pytest.approx(here, abs=1e-4)


def test_a_seed_decides_all_that_is_drawn() -> None:
    """The same seed and pushes give the same poses to the bit, and the next push or seed has other friction."""

    def poses(seed: int) -> list[DoubleArray]:
        table = Tabletop(BOX, seed=seed)
        found = []
        for _ in range(2):
            table.pose = np.zeros(3)
            found.append(table.push((-0.08, 0.015, 0.0, 0.06)))
        return found

    first, second = poses(1)
    assert all((one == other).all() for one, other in zip(poses(1), (first, second), strict=True))
    assert np.abs(first - second).max() > 1e-4
    assert np.abs(first - poses(2)[0]).max() > 1e-4


def test_a_start_inside_the_object_is_refused() -> None:
    """The error names the place and the depth, and the object stays. A tip that only overlaps the wall is moved out."""
    table = Tabletop(BOX)
    with pytest.raises(InvalidRequestError, match=r"\(0\.01, 0\) m, 30 mm inside the object"):
        table.push((0.01, 0.0, 0.0, 0.05))
    assert (table.pose == 0.0).all()

    moved = Tabletop(BOX, physics=EVEN).push((-0.051, 0.0, 0.0, 0.03))
    assert moved == pytest.approx([0.03, 0.0, 0.0], abs=0.001)


@pytest.mark.parametrize(
    ("push", "message"),
    [
        ((0.0, 1.0, 0.0), "4 finite numbers"),
        ((0.0, math.nan, 0.0, 0.05), "4 finite numbers"),
        ((0.0, 1e300, 0.0, 0.05), "4 finite numbers within 1e"),
        ((0.0, 1.0, 0.0, -0.05), "0 to 1 m"),
        ((0.0, 1.0, 0.0, 1.5), "0 to 1 m"),
    ],
)
def test_a_push_that_is_none_is_refused(push: npt.ArrayLike, message: str) -> None:
    """Four finite numbers and a length of at most a metre are asked for."""
    with pytest.raises(InvalidRequestError, match=message):
        Tabletop(BOX).push(push)


@pytest.mark.parametrize("push", [(*LEFT, 0.0), (*LEFT, 0.019), (-0.08, 0.0, math.pi, 0.5), (-0.08, 0.036, 0.0, 0.2)])
def test_a_push_that_does_not_reach_the_object_leaves_it(push: npt.ArrayLike) -> None:
    """A push that is too short, heads away or passes by leaves the pose to the bit."""
    assert (Tabletop(BOX).push(push) == 0.0).all()


def test_an_object_lags_behind_at_its_heavy_side() -> None:
    """A push through the centroid turns the object about a centre of mass that is beside it."""
    turns = [
        Tabletop(BOX, physics=EVEN, centre_of_mass_m=(0.0, y)).push((*LEFT, 0.06))[2] for y in (-0.015, 0.0, 0.015)
    ]
    assert turns[0] < -0.05
    assert turns[1] == pytest.approx(0.0, abs=1e-3)
    assert turns[2] == pytest.approx(-turns[0], abs=0.01)


def test_a_rough_pusher_drags_the_wall_along() -> None:
    """Along a wall that it meets at an angle, a tip with more friction drags the object further sideways."""
    slant = (-0.08, -0.02, 0.6, 0.06)
    smooth, rough = (Tabletop(BOX, physics=EVEN, friction=friction).push(slant)[1] for friction in (0.05, 0.6))
    assert rough > smooth + 0.002


def test_a_thick_pusher_touches_earlier() -> None:
    """A tip that is 5 mm thicker moves the object 5 mm further."""
    thin, thick = (
        Tabletop(BOX, physics=EVEN, pusher_radius_m=radius).push((*LEFT, 0.06))[0] for radius in (0.005, 0.01)
    )
    assert thick - thin == pytest.approx(0.005, abs=0.0005)


@pytest.mark.parametrize("family", ["box", "irregular-polygon", "T", "wrench"])
def test_it_agrees_with_the_quasi_static_simulation(family: str) -> None:
    """Half of the places on the object are within 1.5 mm of those of the other simulation on the same feet."""
    rng = np.random.default_rng(3)
    outline = draw_outline(family, rng)
    pushes = draw_pushers(outline, np.full(12, 0.05), PUSHER_RADIUS_M, rng)
    quasi = body(outline, "even", np.random.default_rng(0))
    expected = push_body(quasi, pushes, PUSHER_RADIUS_M, even_conditions(quasi, len(pushes)))

    table = Tabletop(outline, physics=EVEN)
    found = []
    for push in pushes:
        table.pose = np.zeros(3)
        found.append(table.push(push))
    apart = np.abs(np.array(found) - expected)
    assert np.median(np.hypot(apart[:, 0], apart[:, 1])) < 0.0015
    assert np.median(apart[:, 2]) * outline.size_m < 0.0015
    assert np.hypot(*expected[:, :2].T).max() > 0.01


def test_a_small_object_does_not_tip_over() -> None:
    """A rod of 20 mm, which is less wide than high, slides along instead."""
    rod = Outline.of([(-0.01, -0.0025), (0.01, -0.0025), (0.01, 0.0025), (-0.01, 0.0025)])
    pose = Tabletop(rod, physics=EVEN).push((0.0, -0.012, math.pi / 2, 0.06))
    assert pose == pytest.approx([0.0, 0.06 - (0.012 - 0.0025 - PUSHER_RADIUS_M), 0.0], abs=0.001)
