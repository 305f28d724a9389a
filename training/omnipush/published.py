"""Published facts of Omnipush beside its files: normalisation statistics, and splits into training and test objects.

The figures are in ``omnipush_facts.json`` and ``omnipush_outcomes.json``, which name their sources.
"""

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from service.pushing.contexts import ObjectContext

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Normalisation:
    """Normalisation statistics: mean and standard deviation of inputs and outputs, float64 [3] each, in SI units."""

    input_mean: npt.NDArray[np.float64]
    input_std: npt.NDArray[np.float64]
    output_mean: npt.NDArray[np.float64]
    output_std: npt.NDArray[np.float64]

    def normalised(self, pushers: Array, outcomes: Array) -> tuple[Array, Array]:
        """Convert pushes from SI units to the units of the release's normalised files."""
        return (pushers - self.input_mean) / self.input_std, (outcomes - self.output_mean) / self.output_std

    def in_si(self, pushers: Array, outcomes: Array) -> tuple[Array, Array]:
        """Convert pushes from the units of the release's normalised files to SI units."""
        return pushers * self.input_std + self.input_mean, outcomes * self.output_std + self.output_mean


@dataclass(frozen=True)
class Split:
    """Split of the objects of a set-up into training objects and held-out test objects."""

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]
    test_surface: str | None = None  # name of the folder beside that of the training objects, None for the same one


@dataclass(frozen=True)
class RecordedOutcomes:
    """Outcomes of the raw recordings of objects without weights on ABS, pushes that moved nothing included."""

    did_not_move_share: float
    quantiles: tuple[float, ...]
    distance_mm: tuple[float, ...]  # at the quantiles, of the pushes that moved the object by over 1 mm
    turn_deg: tuple[float, ...]  # of the same pushes, without the sign


@cache
def _facts(name: str = "omnipush_facts.json") -> dict[str, Any]:
    """Read published facts that ship with the trainer."""
    text = resources.files("training.omnipush").joinpath(name).read_text(encoding="utf-8")
    facts: dict[str, Any] = json.loads(text)
    return facts


def recorded_outcomes() -> RecordedOutcomes:
    """Return the quantiles of distance and turn of Omnipush's recordings (CC-BY-4.0, Bauza et al., IROS 2019)."""
    facts = _facts("omnipush_outcomes.json")
    moved = facts["of_those_that_moved_over_1_mm"]
    rows = (tuple(moved[name]) for name in ("quantiles", "distance_mm", "abs_yaw_deg"))
    return RecordedOutcomes(facts["did_not_move_share"], *rows)


def published_normalisation() -> Normalisation:
    """Return the published statistics of Omnipush, used for every dataset."""
    facts = _facts()["normalisation"]
    names = ("input_mean", "input_std", "output_mean", "output_std")
    return Normalisation(*(np.array(facts[name], dtype=np.float64) for name in names))


def different_objects() -> Split:
    """Return the published split of the 250 ABS objects: 200 to train on, 50 held out."""
    facts = _facts()["different_objects"]
    return Split("different-objects", tuple(facts["train"]), tuple(facts["test"]))


def all_objects() -> Split:
    """Return all 250 ABS objects to train on, none held out: for a model to serve, after its recipe was measured."""
    return Split("all-objects", omnipush_descriptors(), ())


def different_surfaces() -> Split:
    """Return all 250 objects on ABS to train on, and 10 held out on plywood, of which 9 are among the 250."""
    test = tuple(_facts()["different_surfaces"]["test_plywood"])
    return Split("different-surfaces", omnipush_descriptors(), test, test_surface="plywood")


def different_weights(held_out: int) -> Split:
    """Return the split that holds out the objects with this many weights (0, 1 or 2) and trains on all others."""
    found = omnipush_descriptors()
    test = tuple(name for name in found if weight_count(name) == held_out)
    train = tuple(name for name in found if weight_count(name) != held_out)
    return Split(f"different-weights-{held_out}", train, test)


def weight_count(descriptor: str) -> int:
    """Return the number of sides of an object that carry a weight."""
    return sum(side.weight != "a" for side in ObjectContext.from_descriptor(descriptor).sides)


def omnipush_descriptors() -> tuple[str, ...]:
    """Return the descriptors of all 250 objects of the benchmark, sorted."""
    split = different_objects()
    return tuple(sorted(split.train + split.test))
