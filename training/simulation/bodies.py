"""Bodies: objects of any outline, and how their weight is spread over the plate.

A body rests on feet, points of its underside with a share of the weight each (``loads``). Sliding is quasi-static, so
that the mass itself does not matter, only how it is shared. ``pressure`` names the spread: ``even`` over the underside,
``rim`` along the outline, ``mixed`` a drawn share of both, ``few`` three to six points, as of a block on a rough plate.
Loads always balance at the centre of mass.

``Physics`` holds the constants that differ from body to body and from push to push. ``RECORDED`` is chosen by recorded
pushes, see ``benchmarks/scene.py`` and docs/results/scene. ``ANY_PLATE`` is that of drawn objects.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from service.pushing.outlines import Outline
from service.pushing.support import balanced, even_points
from training.simulation.exact import exp
from training.simulation.surfaces import LEAST_FRICTION, Array

PRESSURES: Final = ("even", "rim", "mixed", "few")
RIM_FEET: Final = 20
FEWEST_FEET, MOST_FEET = 3, 6  # of a body on few feet
_TRIES: Final = 40


@dataclass(frozen=True)
class Physics:
    """Physical constants of simulated pushes: one set for all shapes."""

    contact: float = 0.20
    """Mean coefficient of friction of pusher and object."""
    contact_spread: float = 0.05
    """Its standard deviation from push to push."""
    roughness: float = 0.47
    """Standard deviation of the logarithm of each foot's friction, drawn for each push: plate and body are not flat,
    and friction changes over the plate."""
    roughness_spread: float = 0.5
    """Standard deviation of the logarithm of the roughness itself, drawn for each push: some places are worse."""
    misplaced_m: float = 0.0004
    """Standard deviation of the object's place at the start of a push, along each axis, from the tracked one."""
    misplaced_rad: float = 0.004
    """Likewise of its yaw."""
    tracker_std: tuple[float, float, float] = (1.66e-5, 1.66e-5, 2.33e-4)
    """Of one reading of the tracker: m, m, rad (two readings of an untouched object differ by 0.0235 mm, 0.33 mrad)."""
    pressures: tuple[str, ...] = ("mixed", "few", "few", "few")
    """How weight is spread under a body on a plate that is not known, drawn for each body, all as likely."""
    plates: tuple[tuple[str, str], ...] = (("abs", "even"), ("plywood", "rim"))
    """How weight is spread on the plates that were recorded: a soft plate bears evenly, a hard one at the rim."""

    def of(self, contact: float | None) -> "Physics":
        """Return the constants for an object whose friction with the pusher is known, or None."""
        return self if contact is None else replace(self, contact=contact)


RECORDED: Final = Physics()
# One of four bodies rests on a few feet, as on a rough plate. The others press evenly, which keeps the mean of any
# pressure where recordings have it. What is not known of a push is wider than between two repeats of it,
# because a frame that is off by half a millimetre is so in both (docs/log.md).
ANY_PLATE: Final = replace(
    RECORDED, pressures=("even", "even", "even", "few"), misplaced_m=0.001, misplaced_rad=0.01, roughness=0.55
)


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of n pushes of a body with k feet: what varies from push to push and is not recorded."""

    loads: Array
    """(k, n): friction of each foot, up to a common factor: its load times the coefficient of the plate there."""
    contact: Array
    """(n,): coefficient of friction of the pusher on the object."""
    misplaced: Array
    """(n, 3): the object's true pose before the push in the frame that the tracker sees: x_m, y_m, yaw_rad."""

    def select(self, rows: slice) -> "Conditions":
        """Return the conditions of some pushes."""
        return Conditions(self.loads[:, rows], self.contact[rows], self.misplaced[rows])


@dataclass(frozen=True, eq=False)
class Body:
    """Body: outline, feet and the share of the weight on each, in the frame of the outline."""

    outline: Outline
    centre_of_mass_m: Array  # (2,)
    feet_m: Array  # (k, 2)
    loads: Array  # (k,), their sum is 1


def body(outline: Outline, pressure: str, rng: np.random.Generator, centre_of_mass_m: Array | None = None) -> Body:
    """Create a body whose weight is spread in a named way, with random numbers where the way has any.

    Args:
        outline: of the object.
        pressure: one of ``PRESSURES``.
        rng: generator of the random numbers.
        centre_of_mass_m: (2,) in the frame of the outline, by default the centroid.

    Raises:
        ValueError: the name is not known, or no feet balance at the centre of mass, as it lies outside of the outline.
    """
    if pressure not in PRESSURES:
        raise ValueError(f"pressure {pressure!r} is not one of {', '.join(PRESSURES)}")
    centre = outline.centroid_m if centre_of_mass_m is None else np.asarray(centre_of_mass_m, dtype=np.float64)
    if pressure == "few":
        found = _on_few_feet(outline, centre, rng)
        if found is not None:
            return found
    share = {"even": 0.0, "rim": 1.0, "few": 1.0}.get(pressure)
    share = rng.uniform() if share is None else share
    parts = [(even_points(outline), 1.0 - share), (rim_feet(outline), share)]
    parts = [part for part in parts if part[1] > 0.0]
    feet = np.concatenate([part for part, _ in parts])
    spread = np.concatenate([np.full(len(part), weight / len(part)) for part, weight in parts])
    loads = balanced(feet, spread, centre, outline.size_m)
    if loads is None:
        raise ValueError("the centre of mass lies outside of the outline")
    return Body(outline, centre, feet, loads)


def draw_body(
    outline: Outline, physics: Physics, rng: np.random.Generator, centre_of_mass_m: Array | None = None
) -> Body:
    """Draw how the weight of an object is spread, as the constants say."""
    return body(outline, physics.pressures[rng.integers(len(physics.pressures))], rng, centre_of_mass_m)


def draw_conditions(body: Body, physics: Physics, count: int, rng: np.random.Generator) -> Conditions:
    """Draw the conditions of ``count`` pushes."""
    roughness = physics.roughness * exp(physics.roughness_spread * rng.normal(size=count))
    rough = roughness * rng.normal(size=(len(body.loads), count))
    contact = rng.normal(physics.contact, physics.contact_spread, count)
    misplaced = rng.normal(size=(count, 3)) * (physics.misplaced_m, physics.misplaced_m, physics.misplaced_rad)
    return Conditions(body.loads[:, None] * exp(rough), np.maximum(contact, LEAST_FRICTION), misplaced)


def even_conditions(body: Body, count: int, contact: float = RECORDED.contact) -> Conditions:
    """Return conditions without variation."""
    return Conditions(np.repeat(body.loads[:, None], count, axis=1), np.full(count, contact), np.zeros((count, 3)))


def rim_feet(outline: Outline) -> Array:
    """Return ``RIM_FEET`` points along an outline, (k, 2), at even distances."""
    lengths = np.sqrt((outline.edges**2).sum(axis=1))
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    along = (np.arange(RIM_FEET) + 0.5) / RIM_FEET * ends[-1]
    edge = np.searchsorted(ends, along, side="right") - 1
    found: Array = outline.corners[edge] + outline.edges[edge] * ((along - ends[edge]) / lengths[edge])[:, None]
    return found


def _on_few_feet(outline: Outline, centre_m: Array, rng: np.random.Generator) -> Body | None:
    """Return a body on a few random feet that surround the centre of mass well, or None if none were found."""
    places = np.concatenate([even_points(outline), rim_feet(outline)])
    for _ in range(_TRIES):
        feet = places[rng.choice(len(places), rng.integers(FEWEST_FEET, MOST_FEET + 1), replace=False)]
        loads = balanced(feet, np.full(len(feet), 1.0 / len(feet)), centre_m, outline.size_m)
        if loads is not None and loads.min() > 0.02:
            return Body(outline, centre_m, feet, loads)
    return None
