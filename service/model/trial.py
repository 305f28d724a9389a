"""Trial of a graph: it is checked and evaluated once in a process of its own, before this process loads it.

A hostile graph can take any memory and time in shape inference, while onnxruntime evaluates constants, and in its first
prediction. The trial process (``service.model.trial_process``) has limits of both, so it dies alone. It is started for
the first graph, tries one graph after the other, and ends once there is none for a moment: a process takes 0.3 s to
start and 80 MB, a trial 20 ms. A graph that passed or failed is not tried again in the life of this process.
"""

import atexit
import contextlib
import functools
import hashlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, Final

from service.errors import BrokenModelError, RegistryError
from service.model.tensors import GraphSize, Tensor

PATIENCE_S: Final = 60.0  # for a trial on a busy machine. Its processor time is limited far below that
MAX_REMEMBERED: Final = 1000
_KEPT: Final = ("LD_LIBRARY_PATH", "LANG", "TZ")  # of the environment. The process needs none of the secrets in it
_ADDED: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "ORT_DISABLE_TELEMETRY": "1"}


def try_out(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> GraphSize:
    """Check a graph and evaluate it once, in another process. Return its size.

    Raises:
        BrokenModelError: the graph breaks a rule, or takes too much memory or time.
        RegistryError: no process can be started.
    """
    return _trials(os.getpid()).result(model, inputs, outputs)


@functools.cache
def _trials(_: int) -> "_Trials":
    """Return the trials of this process. One that was forked has none of its parent's."""
    trials = _Trials()
    atexit.register(trials.close)
    return trials


class _Trials:
    """The trial process, and the results of the graphs that were tried."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._results: OrderedDict[bytes, GraphSize | str] = OrderedDict()  # size, or the reason of the refusal

    def result(self, model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> GraphSize:
        """See ``try_out``."""
        request = {
            part: [asdict(tensor) for tensor in each] for part, each in (("inputs", inputs), ("outputs", outputs))
        }
        head = json.dumps({"bytes": len(model), **request}).encode() + b"\n"
        digest = hashlib.sha256(head)
        digest.update(model)
        key = digest.digest()
        with self._lock:
            found = self._results.get(key)
            if found is None:
                found = self._ask(head, model)
                self._results[key] = found
                if len(self._results) > MAX_REMEMBERED:
                    self._results.popitem(last=False)
        if isinstance(found, str):
            raise BrokenModelError(found)
        return found

    def _ask(self, head: bytes, model: bytes) -> GraphSize | str:
        for _ in range(2):
            process = self._running()
            answer = _exchange(process, head, model)
            if answer:
                document = json.loads(answer)
                return document["fault"] or GraphSize(document["row_bytes"], document["context_bytes"])
            status = process.wait()
            self.close()
            if status != 0:
                return _cause(status)
            # The process ended for want of work in the moment in which it was asked.
        raise RegistryError("model.onnx: the process that checks graphs ends at once")

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._process = _start()
        return self._process

    def close(self) -> None:
        """End the trial process."""
        process, self._process = self._process, None
        if process is not None:
            if process.stdin is not None:
                with contextlib.suppress(BrokenPipeError):
                    process.stdin.close()
            process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


def _start() -> subprocess.Popen[bytes]:
    kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
    path = os.pathsep.join(place or str(Path.cwd()) for place in sys.path)
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-B", "-m", "service.model.trial_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=kept | _ADDED | {"PYTHONPATH": path},
        )
    except OSError as error:
        raise RegistryError(f"model.onnx: no process to check it can be started: {error.strerror}") from error
    threading.Thread(target=process.wait, daemon=True, name="trial-end").start()  # collects its exit status
    return process


def _exchange(process: subprocess.Popen[bytes], head: bytes, model: bytes) -> bytes:
    """Send a graph and return the line of the answer, which is empty if the process ended."""
    watchdog = threading.Timer(PATIENCE_S, process.kill)
    watchdog.daemon = True
    watchdog.start()
    try:
        stdin, stdout = _pipe(process.stdin), _pipe(process.stdout)
        stdin.write(head)
        stdin.write(model)
        stdin.flush()
        return bytes(stdout.readline())
    except BrokenPipeError:
        return b""
    finally:
        watchdog.cancel()


def _pipe(stream: IO[bytes] | None) -> Any:
    return stream


def _cause(status: int) -> str:
    """Return the reason of a process that ended before it answered."""
    if status in (-signal.SIGXCPU, -signal.SIGKILL):
        return "model.onnx: checking it takes more time than is allowed"
    return "model.onnx: checking it takes more memory than is allowed"
