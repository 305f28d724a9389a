"""Predictor: the seam around onnxruntime, arrays in, arrays out. No other module imports onnxruntime."""

import math
import os
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, Final, Protocol

import numpy as np

# Official builds of onnxruntime send telemetry unless this is set before the import.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime

from service.errors import BrokenModelError, PredictionError
from service.model.tensors import FloatArray, Gaussians, GraphSize, IndexArray, Tensor
from service.model.trial import try_out
from service.processors import processors
from service.turns import TURN, ending

# onnxruntime computes the sines of four numbers at once, and those of the remainder with other instructions, which
# round differently. Rows are padded to a multiple of four, so a row gets the same bits beside any other rows.
ROWS_AT_ONCE: Final = 4
_FIRST_CONTEXT: Final = np.zeros(ROWS_AT_ONCE, dtype=np.int64)
CALL_BYTES: Final = 128 << 20  # of the intermediate tensors of one call, with room for the largest that is accepted
_TYPES: Final = {"float32": "tensor(float)", "int64": "tensor(int64)"}


class Predictor(Protocol):
    """A predictor of one model version. Units are those that the manifest declares.

    The prediction of a row depends on that row and its context alone: to the bit, and of a graph that sums over parts
    of an object, as mechanics does, to a few units in the last digit.
    """

    @property
    def size(self) -> GraphSize:
        """Return the memory that a call takes for each row and each context. Its caller makes calls small enough."""
        ...

    def predict(
        self, rows: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """Return the predictions of rows (n, inputs), each with the context that its index names.

        Args:
            rows: (n, inputs) float32. Those of a push model are pusher poses in m, m, rad, and for some also lengths.
            contexts: (g, ...) float32 each, the tensors of the distinct contexts, in the order of the graph's inputs.
                Empty for models without context.
            context_index: (n,) int64, the context of each row, or None for models without context.

        Raises:
            PredictionError: the runtime failed, or its answer is not a Gaussian.
        """
        ...


PredictorFactory = Callable[[bytes, Sequence[Tensor], Sequence[Tensor]], Predictor]
"""Creates a predictor from the bytes of a graph and the inputs and outputs that the graph must have."""


class OnnxPredictor:
    """A predictor that runs a graph in onnxruntime, on one thread: networks are small, and requests run in parallel."""

    def __init__(
        self, model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor], tried: GraphSize | None = None
    ) -> None:
        """Create a session from verified bytes, once the graph has passed its trial in another process.

        Args:
            model: the ONNX file.
            inputs: the inputs that the graph must have, in order: rows, and for a model with context also the tensors
                of the contexts, and the index of each row's context.
            outputs: the outputs that it must have, in order: mean and std, and for some the unfamiliarity.
            tried: size of a graph that is on trial in this process. None: the graph is tried first.

        Raises:
            BrokenModelError: the trial or onnxruntime refuses the graph, or its tensors differ.
            RegistryError: no process can be started for the trial.
        """
        self.size = tried or try_out(model, inputs, outputs)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        _share_memory(options)
        try:
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # errors of onnxruntime share no other base class
            raise BrokenModelError("model.onnx: onnxruntime refuses the graph") from error
        # The session keeps the file in memory to fall back to another device. There is no other device here.
        self._session.disable_fallback()
        self._session._model_bytes = None
        _check_tensors("inputs", self._session.get_inputs(), inputs)
        _check_tensors("outputs", self._session.get_outputs(), outputs)
        self._inputs = tuple(tensor.name for tensor in inputs)
        self._outputs = tuple(tensor.name for tensor in outputs)
        self._padding = np.zeros((ROWS_AT_ONCE, int(inputs[0].shape[-1])), dtype=np.float32)

    def predict(
        self, rows: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``Predictor.predict``."""
        count = len(rows)
        missing = -count % ROWS_AT_ONCE
        if missing:
            rows = np.concatenate((rows, self._padding[:missing]))
            if context_index is not None:
                context_index = np.concatenate((context_index, _FIRST_CONTEXT[:missing]))
        feed = dict(zip(self._inputs, (rows, *contexts, context_index), strict=False))
        try:
            found = Gaussians(*self._run(feed))
        except Exception as error:  # see above
            raise PredictionError("the runtime could not evaluate the model") from error
        if missing:
            found = found.rows(slice(count))
        if not _is_gaussian(found):
            raise PredictionError("the model gave a number that is not finite, or a std that is not positive")
        np.add(found.mean, 0.0, out=found.mean)  # an object that stays is at 0, not at -0
        return found

    def _run(self, feed: dict[str, Any]) -> Any:
        """Run the graph. In a thread whose answer becomes late the run ends at the next node of the graph."""
        if TURN.get() is None:
            return self._session.run(self._outputs, feed)
        options = onnxruntime.RunOptions()
        with ending(partial(setattr, options, "terminate", True)):
            return self._session.run(self._outputs, feed, options)


@cache
def _shared_memory() -> None:
    """Create the memory arena of this process. With one of its own, each version would keep that of its largest call.

    Its size is limited, as the last bound for a graph whose tensors grow in a way that no check foresaw: the call
    fails. Weights lie elsewhere. onnxruntime has one environment per process, so this is called once.
    """
    place = onnxruntime.OrtMemoryInfo(
        "Cpu", onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, onnxruntime.OrtMemType.DEFAULT
    )
    most = (processors() + 2) * CALL_BYTES
    onnxruntime.create_and_register_allocator(place, onnxruntime.OrtArenaCfg(most, -1, -1, -1))


def _share_memory(options: onnxruntime.SessionOptions) -> None:
    _shared_memory()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.add_session_config_entry("session.use_device_allocator_for_initializers", "1")


def _is_gaussian(found: Gaussians) -> bool:
    """Return whether all values are finite and every std positive. One row is checked without numpy's overhead."""
    mean, std, unfamiliarity = found
    if len(mean) == 1:
        stds = std[0].tolist()
        values = (
            mean[0].tolist() + stds if unfamiliarity is None else mean[0].tolist() + stds + unfamiliarity[0].tolist()
        )
        return all(map(math.isfinite, values)) and min(stds) > 0.0
    arrays = (mean, std) if unfamiliarity is None else (mean, std, unfamiliarity)
    return bool(all(np.isfinite(array).all() for array in arrays) and (std > 0.0).all())


def _check_tensors(which: str, found: list[onnxruntime.NodeArg], expected: Sequence[Tensor]) -> None:
    """Compare names, types, rank and fixed dimensions, in order."""
    given = [(tensor.name, tensor.type, [d if isinstance(d, int) else None for d in tensor.shape]) for tensor in found]
    wanted = [
        (tensor.name, _TYPES[tensor.dtype], [d if isinstance(d, int) else None for d in tensor.shape])
        for tensor in expected
    ]
    if given != wanted:
        names = ", ".join(f"{tensor.name} {tensor.dtype} {list(tensor.shape)}" for tensor in expected)
        raise BrokenModelError(f"model.onnx: the {which} are not the expected ones: {names}")
