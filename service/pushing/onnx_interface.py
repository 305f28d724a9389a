"""ONNX interface of a push model: the input and output tensors of its graph."""

from typing import Final

from service.model.tensors import ContextKind, Tensor
from service.pushing.contexts import INDICATOR_LENGTH, MAX_SUPPORT, VISUAL_SIZE
from service.pushing.shape_context import BODY_UNITS, CORNERS, SILHOUETTE_SIZE
from service.pushing.support import MOST_POINTS

_POSE_UNITS: Final = ("m", "m", "rad")
_PUSHER: Final = Tensor("pusher", "float32", ("n", 3), _POSE_UNITS)
_INDICATOR: Final = Tensor("context", "float32", ("g", INDICATOR_LENGTH), ("1",))
_VISUAL: Final = Tensor("context", "float32", ("g", 1, VISUAL_SIZE, VISUAL_SIZE), ("1",))
_PUSHER_WITH_LENGTH: Final = Tensor("pusher", "float32", ("n", 4), (*_POSE_UNITS, "m"))
_SHAPE: Final = (
    Tensor("silhouette", "float32", ("g", 1, SILHOUETTE_SIZE, SILHOUETTE_SIZE), ("1",)),
    Tensor("outline", "float32", ("g", CORNERS, 2), ("m", "m")),
    Tensor("support", "float32", ("g", MOST_POINTS, 3), ("m", "m", "1")),
    Tensor("body", "float32", ("g", len(BODY_UNITS)), BODY_UNITS),
)
_SUPPORT: Final = (
    *(Tensor(f"support_{name}", "float32", ("g", MAX_SUPPORT, 3), _POSE_UNITS) for name in ("pushers", "outcomes")),
    Tensor("support_valid", "float32", ("g", MAX_SUPPORT), ("1",)),
)
_CONTEXT_INDEX: Final = Tensor("context_index", "int64", ("n",), ("1",))
OUTPUTS: Final = tuple(Tensor(name, "float32", ("n", 3), _POSE_UNITS) for name in ("mean", "std"))
OUTPUTS_WITH_UNFAMILIARITY: Final = (*OUTPUTS, Tensor("unfamiliarity", "float32", ("n", 2), ("1", "1")))
UNFAMILIARITY_SINCE: Final = 3  # format of the manifest from which on a graph may have that output


def expected_inputs(kind: ContextKind) -> tuple[Tensor, ...]:
    """Return the inputs that a graph of this context kind must have, in order."""
    if kind is ContextKind.NONE:
        return (_PUSHER,)
    if kind is ContextKind.SHAPE:
        return (_PUSHER_WITH_LENGTH, *_SHAPE, _CONTEXT_INDEX)
    if kind is ContextKind.SUPPORT:
        return (_PUSHER, *_SUPPORT, _CONTEXT_INDEX)
    return (_PUSHER, _VISUAL if kind is ContextKind.VISUAL else _INDICATOR, _CONTEXT_INDEX)
