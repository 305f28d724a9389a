"""Named plans of pushes: where they start, where they aim, and how well they are measured.

A plan's name is part of the declaration of its data, ``dataset.json``. ``RING`` is the plan of the data of before
November 2026, kept to the byte, for the tables and models that name it. ``APPROACH`` is the default.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M
from training.omnipush.layout import SIMULATED
from training.simulation import exact
from training.simulation.approach import Approach, draw_pushers
from training.simulation.scene import PUSHER_RADIUS_M
from training.simulation.solids import Solid, clearance_m, outline, solid
from training.simulation.surfaces import Array

START_RADIUS_M: Final = (0.0755, 0.085)  # of the pusher's start around the object's centre
AIM_RADIUS_M: Final = 0.024  # the push is aimed at a point of this disc around the object's centre
START_CLEARANCE_M: Final = 0.001
# Between two readings of an object that was not touched, Omnipush's tracker differs by 0.0235 mm and 0.33 mrad (std).
READING_STD: Final = (0.0235e-3 / math.sqrt(2.0), 0.0235e-3 / math.sqrt(2.0), 0.33e-3 / math.sqrt(2.0))
# A quarter of the pushes that touch pass anywhere over the object. Together they have Omnipush's recorded distances and
# turns (benchmarks/omnipush_quantiles.py).
OMNIPUSH_APPROACH: Final = Approach(miss_share=0.1, central_share=0.8, central_half_width=0.6)

Arctangent = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Plan:
    """Plan of pushes of any object of Omnipush."""

    name: str
    summary: str
    folder: Path  # of its data, by default
    draw: Callable[[ObjectContext, int, np.random.Generator], Array]
    """Draws pusher poses that do not touch the object, (count, 3): x_m, y_m, angle_rad."""
    tracker_std: tuple[float, float, float]  # of a reading of the object: m, m, rad
    arctan2: Arctangent = exact.atan2
    declared: Mapping[str, object] = field(default_factory=dict)
    """Entries of ``dataset.json`` of this plan alone."""


def sample_pushers(body: Solid, count: int, rng: np.random.Generator) -> Array:
    """Draw random pusher poses from a ring around an object, (count, 3): x_m, y_m, angle_rad."""
    found = np.empty((0, 3))
    while len(found) < count:
        start = _polar(rng.uniform(*START_RADIUS_M, count), rng)
        aim = _polar(AIM_RADIUS_M * np.sqrt(rng.uniform(0.0, 1.0, count)), rng)
        towards = aim - start
        poses = np.column_stack([start, np.arctan2(towards[:, 1], towards[:, 0])])
        clearance = np.min([clearance_m(piece, start) for piece in body.pieces], axis=0)
        found = np.concatenate([found, poses[clearance > PUSHER_RADIUS_M + START_CLEARANCE_M]])
    return found[:count]


def _from_ring(context: ObjectContext, count: int, rng: np.random.Generator) -> Array:
    return sample_pushers(solid(context), count, rng)


def _over_the_approach(context: ObjectContext, count: int, rng: np.random.Generator) -> Array:
    lengths_m = np.full(count, PUSH_LENGTH_M)
    return draw_pushers(outline(context), lengths_m, PUSHER_RADIUS_M, rng, OMNIPUSH_APPROACH)[:, :3]


def _polar(radius: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(-np.pi, np.pi, len(radius))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


RING: Final = Plan(
    "ring",
    "starts 75.5 to 85 mm from the centre, aims within 24 mm of it; the data of the tables of before November 2026",
    Path("data/simulated"),
    _from_ring,
    # Yu et al. 2016, section IV: accurate below 0.5 mm and 0.5 degrees, taken as three standard deviations
    tracker_std=(0.00017, 0.00017, 0.0029),
    arctan2=np.arctan2,  # whose last bits depend on the processor, as those of the published data
    declared={"start_radius_m": list(START_RADIUS_M), "aim_radius_m": AIM_RADIUS_M},
)
APPROACH: Final = Plan(
    "approach",
    "starts between touch and 50 mm before it, glancing and missing pushes; outcomes spread as Omnipush's",
    SIMULATED,
    _over_the_approach,
    tracker_std=READING_STD,
    declared={
        "plan": "approach",
        "miss_share": OMNIPUSH_APPROACH.miss_share,
        "central_share": OMNIPUSH_APPROACH.central_share,
        "central_half_width": OMNIPUSH_APPROACH.central_half_width,
    },
)
PLANS: Final = {plan.name: plan for plan in (APPROACH, RING)}
DEFAULT_PLAN: Final = APPROACH
