"""Bodies: feet under the outline whose loads balance at the centre of mass, and conditions drawn from the seed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from service.pushing.outlines import Outline
from training.simulation.bodies import (
    MOST_FEET,
    PRESSURES,
    RECORDED,
    body,
    draw_body,
    draw_conditions,
    rim_feet,
)

ANGLE = 0.4
TURN = np.array([(math.cos(ANGLE), -math.sin(ANGLE)), (math.sin(ANGLE), math.cos(ANGLE))])
OUTLINES = {
    "box": Outline.of([(0.0, 0.0), (0.09, 0.0), (0.09, 0.04), (0.0, 0.04)]),
    "triangle": Outline.of([(0.045, 0.045), (-0.1315, 0.045), (0.045, -0.08061)]),
    "U": Outline.of(
        [(0, 0), (0.08, 0), (0.08, 0.06), (0.06, 0.06), (0.06, 0.02), (0.02, 0.02), (0.02, 0.06), (0, 0.06)]
    ),
    "thin slanting bar": Outline.of(np.array([(0.0, 0.0), (0.2, 0.0), (0.2, 0.002), (0.0, 0.002)]) @ TURN.T),
    "needle": Outline.of([(0.0, 0.0), (0.3, 1e-5), (0.3, -1e-5)]),
    "512 corners": Outline.of(
        [(0.1 * math.cos(math.tau * k / 512), 0.06 * math.sin(math.tau * k / 512)) for k in range(512)]
    ),
}


@pytest.mark.parametrize("pressure", PRESSURES)
@pytest.mark.parametrize("name", OUTLINES)
def test_loads_balance_at_the_centroid_by_default(name: str, pressure: str) -> None:
    """Loads are positive, sum to 1, and their middle is the centroid. Feet lie within the outline or on it."""
    outline = OUTLINES[name]
    made = body(outline, pressure, np.random.default_rng(4))

    assert made.loads.sum() == pytest.approx(1.0)
    assert made.loads.min() > 0.0
    assert made.loads @ made.feet_m == pytest.approx(outline.centroid_m, abs=1e-6 * outline.size_m)
    assert outline.distance_m(made.feet_m).max() < 1e-9


@pytest.mark.parametrize("pressure", PRESSURES)
def test_loads_balance_at_a_given_centre_of_mass(pressure: str) -> None:
    """A heavy corner shifts the pressure."""
    centre = np.array([0.065, 0.028])
    made = body(OUTLINES["box"], pressure, np.random.default_rng(4), centre)

    assert made.loads @ made.feet_m == pytest.approx(centre, abs=1e-8)
    assert (made.centre_of_mass_m == centre).all()


@pytest.mark.parametrize("pressure", PRESSURES)
def test_a_centre_of_mass_outside_is_refused(pressure: str) -> None:
    """No feet under the box can balance beside it."""
    with pytest.raises(ValueError, match="centre of mass lies outside"):
        body(OUTLINES["box"], pressure, np.random.default_rng(4), np.array([0.1, 0.02]))


def test_an_unknown_pressure_is_refused_with_the_known_ones() -> None:
    """The message lists the names."""
    with pytest.raises(ValueError, match="'heavy' is not one of even, rim, mixed, few"):
        body(OUTLINES["box"], "heavy", np.random.default_rng(4))


def test_few_feet_are_few_and_drawn() -> None:
    """A body on few feet has three to six, and another seed has others."""
    made = [body(OUTLINES["box"], "few", np.random.default_rng(seed)) for seed in range(20)]

    assert {len(one.feet_m) for one in made} == set(range(3, MOST_FEET + 1))
    assert len({one.feet_m.tobytes() for one in made}) == 20


def test_rim_feet_lie_on_the_rim_at_even_distances() -> None:
    """All are on the outline, and no two are nearer than the shape makes them."""
    outline = OUTLINES["box"]
    feet = rim_feet(outline)

    assert np.abs(outline.distance_m(feet)).max() < 1e-12
    assert np.linalg.norm(np.diff(feet, axis=0), axis=1).max() <= 0.26 / len(feet) + 1e-12


def test_bodies_are_drawn_in_every_way_that_the_constants_name() -> None:
    """Twenty bodies stand on many feet or on few, and the seed decides."""
    counts = [len(draw_body(OUTLINES["box"], RECORDED, np.random.default_rng(seed)).loads) for seed in range(20)]

    assert counts == [
        len(draw_body(OUTLINES["box"], RECORDED, np.random.default_rng(seed)).loads) for seed in range(20)
    ]
    assert min(counts) <= MOST_FEET < max(counts)


def test_conditions_have_the_spreads_of_the_constants() -> None:
    """The mean and the deviation of 20,000 draws are those asked for, and nothing varies if all spreads are 0."""
    made = body(OUTLINES["box"], "even", np.random.default_rng(0))
    drawn = draw_conditions(made, RECORDED, 20_000, np.random.default_rng(1))
    calm = replace(RECORDED, contact_spread=0.0, roughness=0.0, misplaced_m=0.0, misplaced_rad=0.0)
    still = draw_conditions(made, calm, 3, np.random.default_rng(1))

    assert drawn.contact.mean() == pytest.approx(RECORDED.contact, abs=0.002)
    assert drawn.contact.std() == pytest.approx(RECORDED.contact_spread, rel=0.05)
    assert drawn.misplaced.std(axis=0) == pytest.approx([0.0004, 0.0004, 0.004], rel=0.05)
    assert np.median(np.abs(np.log(drawn.loads[0] / made.loads[0]))) == pytest.approx(0.29, abs=0.03)
    assert drawn.contact.min() > 0.0
    assert (still.loads == made.loads[:, None]).all()
    assert (still.misplaced == 0.0).all()


def test_a_known_friction_replaces_the_mean() -> None:
    """Constants of an object with a known friction differ in that alone."""
    assert RECORDED.of(None) is RECORDED
    assert RECORDED.of(0.4) == replace(RECORDED, contact=0.4)
