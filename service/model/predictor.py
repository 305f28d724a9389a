"""The seam around the engine: arrays in, arrays out. The only module that imports onnxruntime."""

import math
import os
from typing import Final, Protocol

import numpy as np

# Official builds tell their maker what they run unless this is set when they are imported; a robot's cell tells nobody.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime

from service.errors import BrokenModelError, PredictionError
from service.model.manifest import OUTPUTS, Tensor, expected_inputs
from service.model.onnx_graph import inspect_graph
from service.pushing.contexts import ContextKind, FloatArray, IndexArray

# The runtime computes sines and the like of four numbers at once, and those left over at the end of a tensor by other
# instructions, which round otherwise: with nothing left over, a push gets the same bits whatever stands beside it.
PUSHES_AT_ONCE: Final = 4
_PADDING: Final = np.zeros((PUSHES_AT_ONCE, 3), dtype=np.float32)
_FIRST: Final = np.zeros(PUSHES_AT_ONCE, dtype=np.int64)


class Predictor(Protocol):
    """A loaded model. SI units in and out, see the contract's ONNX interface.

    What it gives for a push depends on that push and its object alone, to the bit.
    """

    def predict(
        self, pusher: FloatArray, context: FloatArray | None, context_index: IndexArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and std, both (n, 3), of pushes (n, 3) of the objects ``context[context_index]``.

        ``context`` is (g, 36) and ``context_index`` (n,); both are None for models without context.

        Raises:
            PredictionError: the runtime failed, or gave what is no Gaussian.
        """
        ...


class OnnxPredictor:
    """A graph in onnxruntime, on one thread: the networks are small and requests come in parallel."""

    def __init__(self, model: bytes, kind: ContextKind) -> None:
        """Create a session from bytes that were verified.

        Raises:
            BrokenModelError: the graph holds what it may not, the runtime refuses it, or its tensors are not those of
                the contract.
        """
        inspect_graph(model)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own errors share no root below this
            raise BrokenModelError("model.onnx: onnxruntime refuses the graph") from error
        # It keeps the file, to begin anew on another device where this one fails: here is no other.
        self._session.disable_fallback()
        self._session._model_bytes = None
        _check_tensors("inputs", self._session.get_inputs(), expected_inputs(kind))
        _check_tensors("outputs", self._session.get_outputs(), OUTPUTS)
        self._kind = kind

    def predict(
        self, pusher: FloatArray, context: FloatArray | None, context_index: IndexArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """See ``Predictor.predict``."""
        pushes = len(pusher)
        missing = -pushes % PUSHES_AT_ONCE
        if missing:
            pusher = np.concatenate((pusher, _PADDING[:missing]))
        feed: dict[str, FloatArray | IndexArray | None] = {"pusher": pusher}
        if self._kind is not ContextKind.NONE:
            if missing and context_index is not None:
                context_index = np.concatenate((context_index, _FIRST[:missing]))
            feed |= {"context": context, "context_index": context_index}
        try:
            mean, std = self._session.run(("mean", "std"), feed)
        except Exception as error:  # see above
            raise PredictionError("the runtime could not evaluate the model") from error
        if missing:
            mean, std = mean[:pushes], std[:pushes]
        if not _is_gaussian(mean, std):
            raise PredictionError("the model gave a mean or std that is not finite, or a std that is not positive")
        return mean, std


def _is_gaussian(mean: FloatArray, std: FloatArray) -> bool:
    """Whether all is finite and every std positive; one push is checked without numpy, whose calls cost more."""
    if len(mean) == 1:
        means, stds = mean[0].tolist(), std[0].tolist()
        return all(map(math.isfinite, means)) and all(map(math.isfinite, stds)) and min(stds) > 0.0
    return bool(np.isfinite(mean).all() and np.isfinite(std).all() and (std > 0.0).all())


_TYPES = {"float32": "tensor(float)", "int64": "tensor(int64)"}


def _check_tensors(what: str, found: list[onnxruntime.NodeArg], expected: tuple[Tensor, ...]) -> None:
    """Names, types, rank and fixed dimensions, in order."""
    given = [(tensor.name, tensor.type, [d if isinstance(d, int) else None for d in tensor.shape]) for tensor in found]
    wanted = [
        (tensor.name, _TYPES[tensor.dtype], [d if isinstance(d, int) else None for d in tensor.shape])
        for tensor in expected
    ]
    if given != wanted:
        names = ", ".join(f"{tensor.name} {tensor.dtype} {list(tensor.shape)}" for tensor in expected)
        raise BrokenModelError(f"model.onnx: the {what} are not those of the contract: {names}")
