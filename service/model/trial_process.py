"""Trial process: reads graphs from standard input, tries each within limits, and answers a line of JSON for each.

    python -m service.model.trial_process

A request is a line of JSON (the size of the graph in bytes, the inputs and the outputs that it must have) and the
graph. The process writes no files, and ends when its input ends or stays silent for ``IDLE_S``. It is the first that
the kernel ends when memory is short.
"""

import contextlib
import gc
import json
import math
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.errors import BrokenModelError, PredictionError
from service.model.onnx_graph import inspect_graph
from service.model.predictor import ROWS_AT_ONCE, OnnxPredictor
from service.model.push_cost import PieceLimits, PushCost
from service.model.tensors import GraphSize, Tensor
from service.model.trial import OUT_OF_MEMORY

IDLE_S: Final = 3.0
MEMORY_BYTES: Final = 160 << 20  # beside a multiple of the file, which is parsed, copied and loaded
COPIES: Final = 6
UNKNOWN_BYTES: Final = 512 << 20  # of this process before a trial, where the system does not tell
PROCESSOR_S: Final = 4  # for all of a trial, and a second more for each part of the file of this size:
BYTES_PER_S: Final = 8 << 20
MAX_LOAD_S: Final = 0.5  # processor time of a load, which holds other threads up, and a second more for each such part:
LOADED_PER_S: Final = 64 << 20
MAX_PUSH_S: Final = 0.1  # processor time of one push
_CALLS: Final = 3
PIECE_S: Final = 0.5  # estimate for the largest call that is tried, by the time of a push
MAX_RISE: Final = 4.0  # of the processor time of that call over the estimate, beside that of a push


def main() -> None:
    """Answer requests until there are none."""
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # a library that prints must not disturb the answers
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    for kind in (resource.RLIMIT_CORE, resource.RLIMIT_FSIZE):
        resource.setrlimit(kind, (0, 0))
    while select.select([0], [], [], IDLE_S)[0] and (head := sys.stdin.buffer.readline()):
        request = json.loads(head)
        model = sys.stdin.buffer.read(request["bytes"])
        _limit(len(model))
        answers.write(json.dumps(_answer(model, _tensors(request["inputs"]), _tensors(request["outputs"]))).encode())
        answers.write(b"\n")
        del model
        gc.collect()


def _tensors(documents: list[dict[str, Any]]) -> list[Tensor]:
    return [Tensor(part["name"], part["dtype"], tuple(part["shape"]), tuple(part["units"])) for part in documents]


def _limit(size: int) -> None:
    """Limit memory and processor time for a graph of this size, from here on."""
    _lower(resource.RLIMIT_CPU, math.ceil(time.process_time()) + PROCESSOR_S + size // BYTES_PER_S)
    _lower(resource.RLIMIT_DATA, _held_bytes() + MEMORY_BYTES + COPIES * size)


def _lower(kind: int, most: int) -> None:
    """Set a limit, but not above one that the operator set, which only a privileged process may raise."""
    _, hard = resource.getrlimit(kind)
    resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _held_bytes() -> int:
    """Return the memory that counts for the limit and that this process has now, or a bound of it without /proc."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmData"):
                return int(line.split()[1]) << 10
    return UNKNOWN_BYTES


def _answer(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> dict[str, Any]:
    fault, size = None, GraphSize()
    try:
        size = inspect_graph(model)
        began = time.process_time()
        predictor = OnnxPredictor(model, inputs, outputs, tried=size)
        load_s = time.process_time() - began
        _check_time("loading it", load_s, MAX_LOAD_S + len(model) / LOADED_PER_S)
        push_s = _call_s(predictor, inputs, ROWS_AT_ONCE, 1)
        _check_time("a push", push_s, MAX_PUSH_S)
        cost = PushCost(ROWS_AT_ONCE, 1, push_s)
        largest = PieceLimits.of(size, cost, PIECE_S)
        pushes, contexts = largest.pushes, min(largest.contexts, largest.pushes)
        piece_s = _call_s(predictor, inputs, pushes, contexts)
        _check_time(f"a call of {pushes} pushes", piece_s, MAX_PUSH_S + MAX_RISE * cost.seconds_of(pushes, contexts))
    except BrokenModelError as error:
        fault = str(error)
    except (MemoryError, PredictionError):
        fault = "model.onnx: it cannot be evaluated, or not in the memory that is allowed"
    except Exception as error:  # of any library that reads the file. It would be the same next time
        fault = f"model.onnx: it cannot be checked ({type(error).__name__})"
    return {"fault": fault, "row_bytes": size.row_bytes, "context_bytes": size.context_bytes}


def _check_time(part: str, seconds: float, most: float) -> None:
    if seconds > most:
        raise BrokenModelError(
            f"model.onnx: {part} takes {seconds:.2g} s of processor time; at most {most:.2g} s are accepted"
        )


def _call_s(predictor: OnnxPredictor, inputs: Sequence[Tensor], pushes: int, contexts: int) -> float:
    """Predict some pushes of some contexts a few times, and return the lowest processor time: the first also allocates.

    A graph may take more than evenly more time or memory for more pushes.
    """
    rng = np.random.default_rng(0)
    rows, *tensors = (
        rng.normal(0.0, 0.1, [count, *map(int, tensor.shape[1:])]).astype(np.float32)
        for count, tensor in zip(chain((pushes,), repeat(contexts)), inputs[:-1] or inputs, strict=False)
    )
    index = np.arange(pushes) % contexts if tensors else None
    lowest = math.inf
    for _ in range(_CALLS):
        began = time.process_time()
        try:
            predictor.predict(rows, tuple(tensors), index)
        except PredictionError as error:
            if error.__cause__ is not None:  # the runtime failed. An answer that is no Gaussian took as long as one
                raise
        lowest = min(lowest, time.process_time() - began)
        if lowest > MAX_PUSH_S:  # known well enough
            break
    return lowest


if __name__ == "__main__":
    try:
        main()
    except MemoryError:
        sys.exit(OUT_OF_MEMORY)
