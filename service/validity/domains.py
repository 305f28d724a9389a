"""Domain of a version: the pushes and objects that it vouches for.

From format 3 of the manifest on, the graph gives two distances in feature space, for push and object, above 1 outside,
and the manifest has ranges for the words of a warning. ``RING`` is the domain of the versions that were published
before, of which the cards say: trained on starts 75 to 85 mm from the centre and aims within 24 mm of it.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from service.model.manifest import Manifest, Validity
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray

START_DISTANCE: Final = "start_distance_m"
AIM_OFFSET: Final = "aim_offset_m"
LENGTH: Final = "length_m"
SIZE: Final = "size_m"
MOST_WEIGHTS: Final = 2  # of an Omnipush object
_WORDS: Final = {
    START_DISTANCE: "the tip starts {} m from the object's centre",
    AIM_OFFSET: "the push passes the object's centre at {} m",
    LENGTH: "the push is {} m long",
    SIZE: "the object's root mean square radius is {} m",
}
_VALIDITY_SINCE: Final = 3  # format of the manifest
_EVERYTHING: Final = (-np.inf, np.inf)


# Half a millimetre around the ring is left for the tracker's noise.
RING: Final = Validity(
    {START_DISTANCE: (0.075, 0.0855), AIM_OFFSET: (0.0, 0.0245), LENGTH: (PUSH_LENGTH_M, PUSH_LENGTH_M)},
    "a ring of starts around Omnipush's objects, which have at most two weights",
)


def validity_of(manifest: Manifest) -> Validity | None:
    """Return the domain of a version, or None for a later version whose manifest has none."""
    return RING if is_published_without(manifest) else manifest.validity


def is_published_without(manifest: Manifest) -> bool:
    """Return True for the versions from before a manifest could have a domain: ``RING`` is theirs."""
    return manifest.format < _VALIDITY_SINCE


def push_features(pushers: DoubleArray, centres: DoubleArray) -> dict[str, DoubleArray]:
    """Return the features (n,) of pushers (n, 4), x_m, y_m, angle_rad, length_m, about centres (n, 2) or (2,)."""
    x, y = (pushers[:, :2] - centres).T
    aim = np.cos(pushers[:, 2]) * y - np.sin(pushers[:, 2]) * x
    return {START_DISTANCE: np.hypot(x, y), AIM_OFFSET: np.abs(aim), LENGTH: pushers[:, 3]}


def outside(validity: Validity, features: Mapping[str, DoubleArray]) -> npt.NDArray[np.bool_]:
    """Return (n,) true for the rows with a feature outside of its range."""
    found = np.zeros(len(next(iter(features.values()))), dtype=np.bool_)
    for name, values in features.items():
        low, high = validity.ranges.get(name, _EVERYTHING)
        found |= (values < low) | (values > high)
    return found


def in_words(validity: Validity | None, features: Mapping[str, float]) -> list[str]:
    """Return for each feature outside of its range a clause with the value and the range."""
    ranges = {} if validity is None else validity.ranges
    clauses = []
    for name, value in features.items():
        low, high = ranges.get(name, _EVERYTHING)
        if not low <= value <= high:
            clauses.append(f"{_WORDS[name].format(f'{value:.3g}')} (known: {low:.3g} to {high:.3g} m)")
    return clauses
