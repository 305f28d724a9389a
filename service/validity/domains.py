"""Domain of a version: the pushes and objects that it vouches for.

From format 3 of the manifest on, the graph gives two distances in feature space, for push and object, above 1 outside,
and the manifest has ranges for the words of a warning. ``RING`` is the domain of the versions that were published
before, of which the cards say: trained on starts 75 to 85 mm from the centre and aims within 24 mm of it.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from service.model.manifest import Manifest, Validity
from service.model.tensors import ContextKind, FloatArray
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray
from service.pushing.shape_context import BODY, ShapeTensors
from service.validity.known_objects import weight_counts

START_DISTANCE: Final = "start_distance_m"
AIM_OFFSET: Final = "aim_offset_m"
LENGTH: Final = "length_m"
_WORDS: Final = {
    START_DISTANCE: ("the tip starts {} m from the object's centre", "m"),
    AIM_OFFSET: ("the push passes the object's centre at {} m", "m"),
    LENGTH: ("the push is {} m long", "m"),
    "length_over_size": ("the push is {} sizes of the object long", "sizes"),
    "start_over_size": ("the tip starts {} sizes of the object from its centre", "sizes"),
    "weights": ("{} sides of the object have a weight", "sides"),
    "view_mean": ("the mean level of the view is {}", "of white"),
    "view_contrast": ("the levels of the view deviate by {}", "of white"),
    "support_nearest_start_m": ("a push of the support starts {} m from the object's centre", "m"),
    "support_furthest_start_m": ("a push of the support starts {} m from the object's centre", "m"),
    "support_furthest_aim_m": ("a push of the support passes the object's centre at {} m", "m"),
    "support_furthest_move_m": ("a push of the support moved the object by {} m", "m"),
    "support_largest_turn_rad": ("a push of the support turned the object by {} rad", "rad"),
    "size_m": ("the object's size, its root mean square radius, is {} m", "m"),
    "friction": ("the friction is {}", ""),
    "pusher_radius_over_size": ("the tip's radius is {} sizes of the object", "sizes"),
    "centre_of_mass_over_size": ("the centre of mass is {} sizes of the object from its centroid", "sizes"),
}
_VALIDITY_SINCE: Final = 3  # format of the manifest
_EVERYTHING: Final = (-np.inf, np.inf)


# Half a millimetre around the ring is left for the tracker's noise.
RING: Final = Validity(
    {START_DISTANCE: (0.075, 0.0855), AIM_OFFSET: (0.0, 0.0245), LENGTH: (PUSH_LENGTH_M, PUSH_LENGTH_M)},
    "a ring only: pushes of 50 mm that start 75 to 85 mm from the centre of an object of Omnipush and pass within "
    "24 mm of it; objects have at most two weights",
)


def validity_of(manifest: Manifest) -> Validity | None:
    """Return the domain of a version, or None for a later version whose manifest has none."""
    return RING if is_published_without(manifest) else manifest.validity


def is_published_without(manifest: Manifest) -> bool:
    """Return True for the versions from before a manifest could have a domain: ``RING`` is theirs."""
    return manifest.format < _VALIDITY_SINCE


def push_features(
    pushers: DoubleArray, centres: DoubleArray, sizes_m: DoubleArray | None = None
) -> dict[str, DoubleArray]:
    """Return the features (n,) of pushers (n, 4), x_m, y_m, angle_rad, length_m, about centres (n, 2) or (2,).

    Sizes (n,) of the objects are those of models of any shape, or None.
    """
    x, y = (pushers[:, :2] - centres).T
    start, aim = np.hypot(x, y), np.cos(pushers[:, 2]) * y - np.sin(pushers[:, 2]) * x
    found = {START_DISTANCE: start, AIM_OFFSET: np.abs(aim), LENGTH: pushers[:, 3]}
    if sizes_m is None:
        return found
    return {**found, "length_over_size": pushers[:, 3] / sizes_m, "start_over_size": start / sizes_m}


def object_features(kind: ContextKind, tensors: Sequence[FloatArray]) -> dict[str, float]:
    """Return the features of the object of one context, given by its tensors, (...) each."""
    if kind is ContextKind.NONE:
        return {}
    if kind is ContextKind.INDICATOR:
        return {"weights": float(weight_counts(tensors[0][None])[0])}
    if kind is ContextKind.VISUAL:
        return {"view_mean": float(tensors[0].mean()), "view_contrast": float(tensors[0].std())}
    if kind is ContextKind.SUPPORT:
        return _support_features(*(tensor.astype(np.float64) for tensor in tensors))
    body = dict(zip(BODY, ShapeTensors(*tensors).body.tolist(), strict=True))
    off = math.hypot(body["centre_of_mass_x"] - body["centroid_x"], body["centre_of_mass_y"] - body["centroid_y"])
    size_m = body["size"]
    return {
        "size_m": size_m,
        "friction": body["friction"],
        "pusher_radius_over_size": body["pusher_radius"] / size_m,
        "centre_of_mass_over_size": off / size_m,
    }


def _support_features(pushers: DoubleArray, outcomes: DoubleArray, valid: DoubleArray) -> dict[str, float]:
    """Return the features of a support: pushers and outcomes (50, 3), of which those count that are valid (50,)."""
    given = valid > 0.0
    features = push_features(np.pad(pushers[given], ((0, 0), (0, 1))), np.zeros(2))
    moved_m = np.hypot(*outcomes[given, :2].T)
    return {
        "support_nearest_start_m": float(features[START_DISTANCE].min()),
        "support_furthest_start_m": float(features[START_DISTANCE].max()),
        "support_furthest_aim_m": float(features[AIM_OFFSET].max()),
        "support_furthest_move_m": float(moved_m.max()),
        "support_largest_turn_rad": float(np.abs(outcomes[given, 2]).max()),
    }


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
            words, unit = _WORDS[name]
            known = f"known: {max(low, 0.0):.3g} to {high:.3g} {unit}".rstrip()
            clauses.append(f"{words.format(f'{value:.3g}')} ({known})")
    return clauses
