"""Measures of learning from pushes: supports drawn from the pushes of each object, errors on the other pushes.

**Protocol.** A group is one object on one surface. Of each group, the order of its pushes is drawn anew for every
repeat. The first 50 are the pool, the first k of them the support, and every push outside of the pool is predicted. So
supports of one repeat contain each other, and all learners see the same ones. k = 0 is the model before any push. The
error of a group is the mean over its pushes and repeats, and the error of all is the mean over all predicted pushes.

With **outliers**, each push of a support is replaced with a chance of one in five: by an object that did not move, by a
random pose, or by the outcome of another push of the same object.
"""

import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from tqdm import tqdm

from benchmarks.push_measures import REGION_LIMITS, difference
from benchmarks.refine_learners import Learner, Pushes
from benchmarks.shape_predictions import starts_outside
from service.pushing.poses import DoubleArray
from training.shapes.outlines import draw_outline
from training.simulation.approach import Approach, draw_pushers
from training.simulation.bodies import RECORDED, Physics, body, draw_body
from training.simulation.pushing import simulate_pushes
from training.tables.push_table import PushTable

POOL: Final = 50
FEWEST: Final = 2 * POOL  # pushes of a group
REPLACED: Final = 0.2
_SPREAD: Final = np.array([0.05, 0.05, 1.0])
_FAMILIES: Final = ("box", "rounded-box", "bar", "irregular-polygon", "ellipse", "L", "T", "hammer", "bean", "union")
_LENGTH_M: Final = 0.05
_TIP_M: Final = 0.00475
_SIZES_M: Final = (0.03, 0.06)
FAR: Final = (0.5, 0.8)  # of the centre of mass from the centroid, in sizes
_SIMULATED: Final = 150  # pushes of an object
_TRIES: Final = 200


@dataclass(frozen=True, eq=False)
class Group:
    """Pushes of one object on one surface, with its true body where it is known."""

    name: str
    pushes: Pushes
    centre_of_mass_m: tuple[float, float] | None = None
    friction: float | None = None


@dataclass(frozen=True)
class Measured:
    """Errors of a learner after k pushes: means over all predicted pushes, and the worst group beside k = 0.

    Attributes:
        position_mm: mean distance.
        yaw_deg: mean absolute turn.
        groups: mean errors of each group, in its order: (position_mm, yaw_deg).
        region: share of outcomes in the 90 % region, or None of a learner without spread.
        found: share of the replaced pushes that were named outliers, or None.
        false: share of the other pushes of the supports that were named outliers, or None.
    """

    position_mm: float
    yaw_deg: float
    groups: tuple[tuple[float, float], ...]
    region: float | None
    found: float | None = None
    false: float | None = None


def groups_of(table: PushTable) -> list[Group]:
    """Return the groups of a table that have enough pushes from outside of their object."""
    outside, found = starts_outside(table), []
    for number, item in enumerate(table.objects):
        for place, surface in enumerate(table.surfaces):
            rows = np.flatnonzero((table.object_index == number) & (table.surface_index == place) & outside)
            if len(rows) >= FEWEST:
                pushes = Pushes(
                    item.outline, float(table.pusher_radius_m[rows[0]]), table.pushers[rows], table.outcomes[rows]
                )
                found.append(Group(f"{item.name}, {surface}", pushes))
    return found


def loaded_groups(count: int, pressure: str | None, seed: int) -> list[Group]:
    """Simulate pushes of new objects whose centre of mass is far off the centroid.

    Args:
        count: number of objects.
        pressure: spread of the weight, one of ``bodies.PRESSURES``, or None: drawn as for a plate that is not known.
        seed: of objects and pushes.
    """
    found: list[Group] = []
    for number in range(_TRIES * count):
        if len(found) == count:
            break
        rng = np.random.default_rng([seed, number])
        group = _loaded_group(f"{number}", _FAMILIES[number % len(_FAMILIES)], pressure, rng)
        if group is not None:
            found.append(group)
    return found


def _loaded_group(name: str, family: str, pressure: str | None, rng: np.random.Generator) -> Group | None:
    """Simulate the pushes of one object, or return None if it cannot have such a centre of mass."""
    outline = draw_outline(family, rng)
    outline = type(outline).of(outline.corners * (rng.uniform(*_SIZES_M) / outline.size_m))
    bearing, away = rng.uniform(-np.pi, np.pi), rng.uniform(*FAR) * outline.size_m
    centre = outline.centroid_m + away * np.array([np.cos(bearing), np.sin(bearing)])
    friction = float(np.exp(rng.normal(math.log(RECORDED.contact), 0.35)))
    physics: Physics = RECORDED.of(friction)
    if not outline.contains(centre[None])[0]:
        return None
    try:
        pushed = draw_body(outline, physics, rng, centre) if pressure is None else body(outline, pressure, rng, centre)
    except ValueError:
        return None
    approach = Approach(miss_share=0.0)
    pushers = draw_pushers(outline, np.full(_SIMULATED, _LENGTH_M), _TIP_M, rng, approach)
    outcomes = simulate_pushes(pushed, pushers, _TIP_M, physics, rng)
    return Group(
        f"{family} {name}", Pushes(outline, _TIP_M, pushers, outcomes), (float(centre[0]), float(centre[1])), friction
    )


def measure(
    learner: Learner, groups: Sequence[Group], k: int, repeats: int, seed: int, outliers: bool = False
) -> Measured:
    """Return the errors of a learner after k pushes of each group."""
    errors, squares, of_groups = [], [], []
    named, replaced, supports = [], [], 0
    for group in tqdm(groups, desc=f"{k} pushes", leave=False, disable=None):
        own = []
        for support, asked, wrong in _folds(group, k, repeats, seed, outliers):
            found = learner(support, asked)
            error = difference(asked.outcomes, found.mean)
            own.append(np.stack([1e3 * np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(error[:, 2]))], axis=1))
            if found.std is not None:
                squares.append(((error / found.std) ** 2).sum(axis=1))
            is_named = np.isin(np.arange(k), found.outliers)
            named.append((int((is_named & wrong).sum()), int((is_named & ~wrong).sum())))
            replaced.append(int(wrong.sum()))
            supports += k
        errors += own
        of_groups.append(_pair(np.concatenate(own)))
    found_count, false_count = np.sum(named, axis=0).tolist()
    wrong_count = sum(replaced)
    position_mm, yaw_deg = _pair(np.concatenate(errors))
    region = float(np.mean(np.concatenate(squares) <= REGION_LIMITS[1])) if squares else None
    return Measured(
        position_mm,
        yaw_deg,
        tuple(of_groups),
        region,
        found_count / wrong_count if wrong_count else None,
        false_count / (supports - wrong_count) if supports > wrong_count else None,
    )


def _folds(
    group: Group, k: int, repeats: int, seed: int, outliers: bool
) -> Iterator[tuple[Pushes, Pushes, np.ndarray]]:
    """Yield supports, the pushes to predict, and (k,) true for the pushes of the support that were replaced."""
    pushes = group.pushes
    for repeat in range(repeats):
        rng = np.random.default_rng([seed, repeat, zlib.crc32(group.name.encode())])
        order = rng.permutation(len(pushes.pushers))
        wrong = (rng.random(POOL) < REPLACED)[:k] if outliers else np.zeros(k, dtype=np.bool_)
        outcomes = pushes.outcomes.copy()
        kinds, others = rng.integers(3, size=POOL), rng.integers(len(order), size=POOL)
        poses: DoubleArray = rng.uniform(-1.0, 1.0, (POOL, 3)) * _SPREAD
        for place in np.flatnonzero(wrong):
            replacement = (np.zeros(3), poses[place], pushes.outcomes[others[place]])[kinds[place]]
            outcomes[order[place]] = replacement
        changed = Pushes(pushes.outline, pushes.pusher_radius_m, pushes.pushers, outcomes)
        yield changed.rows(order[:k]), pushes.rows(order[POOL:]), wrong


def _pair(errors: DoubleArray) -> tuple[float, float]:
    position, yaw = errors.mean(axis=0).tolist()
    return position, yaw
