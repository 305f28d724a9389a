"""Judging of pushes, their objects and their predictions: all warnings of an answer.

A single push without any warning is recognised by bounds that take a microsecond. Everything else is judged in columns.
Contact is known for objects whose form is known: by descriptor, from a view, or from the answer of a model of any
shape, which is exactly zero for a push that misses.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from service.model.manifest import Manifest
from service.model.tensors import ContextKind, FloatArray, Gaussians
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray
from service.pushing.shape_context import BODY, PUSHER_RADIUS_M, ShapeTensors
from service.validity.codes import Angles, AnswerWarning, WarningCode
from service.validity.contact import contacts, is_plain_contact
from service.validity.domains import (
    AIM_OFFSET,
    RING,
    START_DISTANCE,
    in_words,
    is_published_without,
    object_features,
    outside,
    push_features,
    validity_of,
)
from service.validity.known_objects import Contexts, known_object
from service.validity.omnipush import is_omnipush, unlike_omnipush
from service.validity.pictures import PICTURES, flags_of

NO_WARNINGS: Final[tuple[AnswerWarning, ...]] = ()
_SIZE: Final = BODY.index("size")
_TURN_RAD: Final = 2.0 * math.pi
_NEAREST_M, _FURTHEST_M = RING.ranges[START_DISTANCE]
_MOST_ASIDE_M: Final = RING.ranges[AIM_OFFSET][1]


class _Judgement(NamedTuple):
    code: WarningCode
    rows: npt.NDArray[np.bool_]  # (n,)
    describe: Callable[[int], str]  # says of one of these rows why


def find_warnings(
    manifest: Manifest, pushers: FloatArray, angles: Angles, contexts: Contexts, found: Gaussians
) -> tuple[AnswerWarning, ...]:
    """Return the warnings of an answer, by their codes.

    Args:
        manifest: of the version that answered.
        pushers: (n, 3) poses of the tip in the object frame, m, m, rad, or (n, 4) with lengths in m.
        angles: those of the request, before they were wrapped.
        contexts: of the pushes.
        found: the predictions.
    """
    if len(pushers) == 1 and (not contexts.tensors or len(contexts.tensors[0]) == 1):
        return find_warnings_of_each(manifest, pushers, [angles], [contexts], found)[0]
    return _judge(manifest, pushers, angles, contexts, found)


def find_warnings_of_each(
    manifest: Manifest,
    pushers: FloatArray,
    angles: Sequence[Angles],
    contexts: Sequence[Contexts],
    found: Gaussians,
) -> list[tuple[AnswerWarning, ...]]:
    """Return the warnings of each of some single pushes, which were predicted together.

    Args:
        manifest: see ``find_warnings``.
        pushers: see ``find_warnings``.
        angles: of each request.
        contexts: of each push, one context or none.
        found: see ``find_warnings``.
    """
    rows, means = pushers.tolist(), found.mean.tolist()
    distances = [None] * len(rows) if found.unfamiliarity is None else found.unfamiliarity.tolist()
    warnings = []
    for number, row in enumerate(rows):
        sent, context = angles[number], contexts[number]
        if _is_plain(manifest, row, sent, context, distances[number], means[number]):
            warnings.append(NO_WARNINGS)
        else:
            part = slice(number, number + 1)
            warnings.append(_judge(manifest, pushers[part], sent, context, found.rows(part)))
    return warnings


def _judge(
    manifest: Manifest, pushers: FloatArray, angles: Angles, contexts: Contexts, found: Gaussians
) -> tuple[AnswerWarning, ...]:
    """Judge pushes in columns. See ``find_warnings``."""
    rows = np.full((len(pushers), 4), PUSH_LENGTH_M)
    rows[:, : pushers.shape[1]] = pushers
    warnings = []
    for code, mask, describe in _judgements(manifest, rows, angles, contexts, found):
        places = np.flatnonzero(mask)
        if len(places):
            first = int(places[0])
            where = f"row {first}: " if len(mask) > 1 else ""
            warnings.append(AnswerWarning(code, f"{where}{describe(first)}.", tuple(places.tolist())))
    return tuple(warnings)


def _is_plain(
    manifest: Manifest,
    pusher: Sequence[float],
    angles: Angles,
    contexts: Contexts,
    distances: Sequence[float] | None,
    mean: Sequence[float],
) -> bool:
    """Return True if one push surely has no warning. Numbers are plain, because numpy takes longer for one push."""
    for _, values in angles:
        if abs(values[0]) > _TURN_RAD:
            return False
    if contexts.flags and any(contexts.flags):
        return False
    kind, key = contexts.kind, contexts.tensors[0].tobytes() if contexts.tensors else b""
    x, y, angle = pusher[:3]
    if distances is not None:
        if max(distances) > 1.0:
            return False
    elif is_published_without(manifest):
        aside = math.cos(angle) * y - math.sin(angle) * x
        if not (_NEAREST_M <= math.hypot(x, y) <= _FURTHEST_M and -_MOST_ASIDE_M <= aside <= _MOST_ASIDE_M):
            return False
        if not is_omnipush(kind, key):
            return False
    if kind is not ContextKind.INDICATOR and kind is not ContextKind.VISUAL:
        return kind is not ContextKind.SHAPE or any(mean)  # of the others no form is known
    known = known_object(kind, key)
    length = pusher[3] if len(pusher) > 3 else PUSH_LENGTH_M
    return not known.flags and is_plain_contact(known, x, y, angle, length, PUSHER_RADIUS_M)


def _judgements(
    manifest: Manifest, rows: DoubleArray, angles: Angles, contexts: Contexts, found: Gaussians
) -> Iterator[_Judgement]:
    """Yield every judgement of rows (n, 4), x_m, y_m, angle_rad, length_m."""
    met = contacts(contexts, rows, found.mean)
    yield _Judgement(WarningCode.NO_CONTACT, met.misses, met.describe_miss)
    yield _Judgement(WarningCode.STARTS_INSIDE, met.inside, met.describe_inside)
    yield _push(manifest, rows, contexts, found)
    yield _object(manifest, len(rows), contexts, found)
    flags = flags_of(contexts)
    if any(flags) and contexts.index is not None:
        for flag, (code, sentence) in PICTURES.items():
            faulty = np.array([flag in of_one for of_one in flags], dtype=np.bool_)
            yield _Judgement(code, faulty[contexts.index], partial(_same, sentence))
    yield _degrees(len(rows), angles)


def unlike_known_pushes(
    manifest: Manifest, rows: DoubleArray, contexts: Contexts, found: Gaussians
) -> npt.NDArray[np.bool_]:
    """Return (n,) true for the pushes (n, 4), x_m, y_m, angle_rad, length_m, that a version does not vouch for."""
    if found.unfamiliarity is not None:
        return found.unfamiliarity[:, 0] > 1.0
    validity = validity_of(manifest)
    if validity is not None and is_published_without(manifest):
        return outside(validity, push_features(rows, *_places(contexts)))
    return np.zeros(len(rows), dtype=np.bool_)


def _push(manifest: Manifest, rows: DoubleArray, contexts: Contexts, found: Gaussians) -> _Judgement:
    """Judge which pushes are outside of the domain."""
    validity = validity_of(manifest)
    features = push_features(rows, *_places(contexts))
    strange = unlike_known_pushes(manifest, rows, contexts, found)

    def describe(row: int) -> str:
        """Name the features out of range, or the distance from the pushes that are known."""
        clauses = in_words(validity, {name: float(values[row]) for name, values in features.items()})
        general = f"start and aim together are unlike the pushes that this version knows{_distance(found, row, 0)}"
        return f"{', and '.join(clauses) or general}{_note(manifest)}"

    return _Judgement(WarningCode.UNFAMILIAR_PUSH, strange, describe)


def _object(manifest: Manifest, count: int, contexts: Contexts, found: Gaussians) -> _Judgement:
    """Judge which pushes are of objects outside of the domain."""
    validity, index = validity_of(manifest), contexts.index
    if found.unfamiliarity is None:
        if not is_published_without(manifest) or index is None or contexts.kind is ContextKind.SHAPE:
            return _Judgement(WarningCode.UNFAMILIAR_OBJECT, np.zeros(count, dtype=np.bool_), str)
        unlike, of_context = unlike_omnipush(contexts.kind, contexts.tensors[0])
        return _Judgement(
            WarningCode.UNFAMILIAR_OBJECT, unlike[index], lambda row: f"{of_context(int(index[row]))}{_note(manifest)}"
        )

    def describe(row: int) -> str:
        """Name the features out of range, or the distance from the objects that are known."""
        place = 0 if index is None else int(index[row])
        clauses = in_words(validity, object_features(contexts.kind, [one[place] for one in contexts.tensors]))
        general = f"the object is unlike those that this version knows{_distance(found, row, 1)}"
        return f"{', and '.join(clauses) or general}{_note(manifest)}"

    return _Judgement(WarningCode.UNFAMILIAR_OBJECT, found.unfamiliarity[:, 1] > 1.0, describe)


def _degrees(count: int, angles: Angles) -> _Judgement:
    """Judge which pushes have an angle that may be one in degrees."""
    columns = {name: np.broadcast_to(np.asarray(values, dtype=np.float64), count) for name, values in angles}
    large = {name: np.abs(values) > _TURN_RAD for name, values in columns.items()}

    def describe(row: int) -> str:
        """Name the angle."""
        name = next(name for name, mask in large.items() if mask[row])
        value = float(columns[name][row])
        meant = f"send {math.radians(value):.4g} if it is meant in degrees"
        return f"{name}: {value:.6g} rad is more than a whole turn (2 pi). Angles are in rad: {meant}"

    over = np.any(list(large.values()), axis=0) if large else np.zeros(count, dtype=np.bool_)
    return _Judgement(WarningCode.ANGLE_LOOKS_LIKE_DEGREES, over, describe)


def _places(contexts: Contexts) -> tuple[DoubleArray, DoubleArray | None]:
    """Return the centroid (n, 2) and size (n,) of each push's object, or the origin (2,) for objects of Omnipush."""
    if contexts.kind is not ContextKind.SHAPE:
        return np.zeros(2), None
    body = ShapeTensors(*contexts.tensors).body[contexts.index].astype(np.float64)
    return body[:, :2], body[:, _SIZE]


def _same(sentence: str, _: int) -> str:
    return sentence


def _distance(found: Gaussians, row: int, column: int) -> str:
    return "" if found.unfamiliarity is None else f" (distance {found.unfamiliarity[row, column]:.3g}, known: up to 1)"


def _note(manifest: Manifest) -> str:
    validity = validity_of(manifest)
    return "" if validity is None else f". {manifest.name}@{manifest.version} vouches for: {validity.note}"
