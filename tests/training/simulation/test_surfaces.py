"""Friction over a plate: spread, correlation, wear and grain."""

import numpy as np
import pytest

from training.simulation.surfaces import (
    ABS,
    LEAST_FRICTION,
    PLYWOOD,
    SURFACES,
    FrictionField,
    Surface,
    draw_conditions,
    even_conditions,
)

PLACES_M = np.random.default_rng(0).uniform(-0.1, 0.1, (4000, 2))


def field_of(surface: Surface, seed: int = 1) -> FrictionField:
    """Return the friction field of a plate of that material."""
    return FrictionField(surface, np.random.default_rng(seed))


@pytest.mark.parametrize("surface", [ABS, PLYWOOD], ids=lambda surface: surface.name)
def test_friction_spreads_over_many_plates_as_was_measured(surface: Surface) -> None:
    """The standard deviation of friction over places and plates is the published one."""
    values = np.concatenate([field_of(surface, seed).at(PLACES_M[:400]) for seed in range(40)])

    assert abs(values.mean()) < 0.1 * surface.spread
    assert values.std() == pytest.approx(surface.spread, rel=0.1)


def test_near_places_are_alike_and_far_ones_are_not() -> None:
    """The covariance of friction is squared-exponential: exp(-1/2) at one correlation length."""
    near, one, far = (np.array([d, 0.0]) for d in (0.001, ABS.correlation_m, 5 * ABS.correlation_m))
    fields = [field_of(ABS, seed).at(np.array([np.zeros(2), near, one, far])) for seed in range(1500)]
    correlation = np.asarray(np.corrcoef(np.array(fields).T))[0]

    # 0.08 is three standard errors of a correlation from 1500 plates
    assert correlation[1] > 0.99
    assert correlation[2] == pytest.approx(np.exp(-0.5), abs=0.08)
    assert abs(correlation[3]) < 0.08


def test_grain_holds_more_across_than_along_and_the_mean_stays() -> None:
    """The geometric mean of friction across and along the grain is the friction without grain."""
    conditions = draw_conditions(PLYWOOD, field_of(PLYWOOD), 20, np.random.default_rng(2))
    friction = conditions.table_friction(np.zeros((20, 8, 2)))

    assert friction.shape == (20, 8, 2)
    assert friction[..., 0] / friction[..., 1] == pytest.approx(PLYWOOD.grain)
    level = conditions.table_level + field_of(PLYWOOD).at(np.zeros((20, 2)))
    assert np.sqrt(friction.prod(axis=-1)) == pytest.approx(np.tile(level[:, None], 8))


def test_friction_has_a_minimum() -> None:
    """Friction is at least ``LEAST_FRICTION`` on the most slippery patch, so no contact is frictionless."""
    slippery = Surface("ice", (0.0, 0.0), 0.5, 0.03, 1.0)
    conditions = draw_conditions(slippery, field_of(slippery), 50, np.random.default_rng(3))

    assert conditions.table_friction(PLACES_M[:400].reshape(50, 8, 2)).min() == LEAST_FRICTION


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
def test_levels_lie_between_worn_and_new(surface: Surface) -> None:
    """Friction levels are between those of a worn and a new plate, and the object lies anywhere, at any yaw."""
    conditions = draw_conditions(surface, field_of(surface), 500, np.random.default_rng(4))

    assert ((surface.level[0] <= conditions.table_level) & (conditions.table_level <= surface.level[1])).all()
    assert np.ptp(conditions.world_poses, axis=0) == pytest.approx([0.2, 0.2, 2 * np.pi], rel=0.05)


def test_even_conditions_are_the_same_for_every_push() -> None:
    """Even conditions have one friction, one place and no grain."""
    conditions = even_conditions(3)

    assert np.unique(conditions.table_friction(PLACES_M[:24].reshape(3, 8, 2))).tolist() == [0.14]
    assert (conditions.world_poses == 0.0).all()
