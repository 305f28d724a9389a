"""Contexts of the Open Inference Protocol: the tensors that a model declares between its pushers and their index.

Each is checked as its kind is in ``/v1``. A shape's tensors are checked one value at a time: that silhouette, outline
and body are of the same object is the client's part. ``service.pushing.shape_context`` makes them.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Final

import numpy as np

from service.api.open_inference.wire import Array
from service.errors import InvalidRequestError
from service.inference.query import ContextBatch
from service.model.manifest import Manifest
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import ObjectContext, index_contexts
from service.pushing.poses import REACH_M, wrap_angles
from service.pushing.shape_context import BODY, SHAPE_REACH_M

CONTEXT: Final = "context"
INDEX: Final = "context_index"
_CACHED_INDICATORS: Final = 4096
_LEVELS_AT_ONCE: Final = 256  # visual contexts rounded at once: their float64 takes 2 MiB
_LARGEST_M: Final = 2.0  # of an object
_FLAG: Final = (0.0, 1.0)
_BODY_RANGES: Final[dict[str, tuple[float, float]]] = {
    "centroid_x": (-SHAPE_REACH_M, SHAPE_REACH_M),
    "centroid_y": (-SHAPE_REACH_M, SHAPE_REACH_M),
    "size": (1e-3, _LARGEST_M),
    "centre_of_mass_x": (-SHAPE_REACH_M, SHAPE_REACH_M),
    "centre_of_mass_y": (-SHAPE_REACH_M, SHAPE_REACH_M),
    "centre_of_mass_is_known": _FLAG,
    "moment_arm": (1e-4, _LARGEST_M),
    "friction": (0.0, 10.0),
    "friction_is_known": _FLAG,
    "pusher_radius": (1e-4, 1.0),
    "pusher_radius_is_known": _FLAG,
}


def read_contexts(manifest: Manifest, inputs: Mapping[str, Array], pushes: int) -> ContextBatch:
    """Return the contexts of an inference request, and the index of each push's context.

    Raises:
        InvalidRequestError: a tensor is missing, holds a value that is not valid, or has another number of contexts.
    """
    kind = manifest.context_kind
    _, *declared = manifest.inputs
    names = [tensor.name for tensor in declared[:-1]]  # without the index
    if not names:
        return ContextBatch(kind, (), None, f"inputs {CONTEXT}")
    where = f"inputs {names[0]}"
    tensors = tuple(_checked(kind, name, inputs.get(name)) for name in names)
    for name, tensor in zip(names[1:], tensors[1:], strict=True):
        if len(tensor) != len(tensors[0]):
            accepted = f"{len(tensors[0])} contexts, as in {names[0]}"
            raise InvalidRequestError.at(f"inputs {name}", f"{len(tensor)} contexts", accepted)
    index = index_contexts(len(tensors[0]), pushes, inputs.get(INDEX), (where, f"inputs {INDEX}"))
    return ContextBatch(kind, tensors, index, where)


def _checked(kind: ContextKind, name: str, given: Array | None) -> FloatArray:
    """Return a tensor of contexts whose values are valid."""
    if given is None:
        raise InvalidRequestError.at("inputs", f"no tensor {name}", f"{name}, as the model's metadata says")
    return _CHECKS[kind, name](given)


def _indicators(given: Array) -> FloatArray:
    """Return indicators (g, 36), each checked to be valid."""
    contexts: FloatArray = given.astype(np.float32)
    for number, row in enumerate(contexts):
        _check_indicator(row.tobytes(), number)
    return contexts


def _check_indicator(row: bytes, number: int) -> None:
    try:
        _known(row)
    except InvalidRequestError:
        ObjectContext.from_indicator(np.frombuffer(row, np.float32).tolist(), f"inputs {CONTEXT}[{number}]")


@lru_cache(maxsize=_CACHED_INDICATORS)
def _known(row: bytes) -> ObjectContext:
    """Return the object context of a valid indicator."""
    return ObjectContext.from_indicator(np.frombuffer(row, np.float32).tolist())


def _levels(given: Array) -> FloatArray:
    """Return visual contexts (g, 1, 32, 32), rounded to 8 bits."""
    if given.min() < 0.0 or given.max() > 1.0:
        raise InvalidRequestError.at(f"inputs {CONTEXT}", "a level outside [0, 1]", "0 (black) to 1 (white)")
    contexts = np.empty(given.shape, dtype=np.float32)
    for start in range(0, len(given), _LEVELS_AT_ONCE):
        part = slice(start, start + _LEVELS_AT_ONCE)
        contexts[part] = np.floor(given[part].astype(np.float64) * 255.0 + 0.5)
    contexts /= np.float32(255.0)
    return contexts


def _silhouettes(given: Array) -> FloatArray:
    """Return signed distances (g, 1, 32, 32)."""
    if given.min() < -1.0 or given.max() > 1.0:
        accepted = "-1 (inside) to 1 (outside), in sizes of the object"
        raise InvalidRequestError.at("inputs silhouette", "a distance outside [-1, 1]", accepted)
    return given.astype(np.float32)


def _outlines(given: Array) -> FloatArray:
    """Return corners (g, 64, 2)."""
    if np.abs(given).max() > SHAPE_REACH_M:
        accepted = f"-{SHAPE_REACH_M:g} to {SHAPE_REACH_M:g} m"
        raise InvalidRequestError.at("inputs outline", "a corner out of reach", accepted)
    return given.astype(np.float32)


def _supports(given: Array) -> FloatArray:
    """Return points of support (g, 37, 3)."""
    shares = given[..., 2]
    if np.abs(given[..., :2]).max() > SHAPE_REACH_M or shares.min() < 0.0 or shares.sum(axis=1).min() <= 0.0:
        accepted = f"points within {SHAPE_REACH_M:g} m, and shares of the weight of 0 or more, not all 0"
        raise InvalidRequestError.at("inputs support", "a point out of reach, or shares that bear no weight", accepted)
    return given.astype(np.float32)


def _poses(name: str, given: Array) -> FloatArray:
    """Return the poses of supports (g, 50, 3), pushers or outcomes, with wrapped angles."""
    far = np.abs(given[..., :2]) > REACH_M
    if far.any():
        place = ", ".join(str(int(part)) for part in np.argwhere(far)[0])
        accepted = f"-{REACH_M:g} to {REACH_M:g} m along each of the object's axes, and 0 in rows without a push"
        raise InvalidRequestError.at(f"inputs {name}[{place}]", "a coordinate out of reach", accepted)
    poses = given.astype(np.float64)
    poses[..., 2] = wrap_angles(poses[..., 2])
    return poses.astype(np.float32)


def _valid_pushes(given: Array) -> FloatArray:
    """Return (g, 50) ones for the pushes of supports, and zeros for rows without one."""
    if not np.isin(given, _FLAG).all() or given.max(axis=1).min() < 1.0:
        accepted = "1 for a push and 0 for a row without one, with at least one push of every object"
        raise InvalidRequestError.at("inputs support_valid", "other values, or an object without a push", accepted)
    return given.astype(np.float32)


def _bodies(given: Array) -> FloatArray:
    """Return the values of bodies (g, 11)."""
    for column, name in enumerate(BODY):
        low, high = _BODY_RANGES[name]
        values = given[:, column]
        wrong = (values < low) | (values > high) | ((values % 1.0 != 0.0) if name.endswith("_is_known") else False)
        if wrong.any():
            where = f"inputs body[{int(wrong.argmax())}, {column}]"
            accepted = f"{name}: 0 or 1" if name.endswith("_is_known") else f"{name}: {low:g} to {high:g}"
            raise InvalidRequestError.at(where, f"{values[wrong.argmax()]:g}", accepted)
    return given.astype(np.float32)


_CHECKS: Final[dict[tuple[ContextKind, str], Callable[[Array], FloatArray]]] = {
    (ContextKind.INDICATOR, CONTEXT): _indicators,
    (ContextKind.VISUAL, CONTEXT): _levels,
    (ContextKind.SHAPE, "silhouette"): _silhouettes,
    (ContextKind.SHAPE, "outline"): _outlines,
    (ContextKind.SHAPE, "support"): _supports,
    (ContextKind.SHAPE, "body"): _bodies,
    (ContextKind.SUPPORT, "support_pushers"): partial(_poses, "support_pushers"),
    (ContextKind.SUPPORT, "support_outcomes"): partial(_poses, "support_outcomes"),
    (ContextKind.SUPPORT, "support_valid"): _valid_pushes,
}
