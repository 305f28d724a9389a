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
from collections import Counter, OrderedDict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, Final

from service.errors import BrokenModelError, RegistryError
from service.model.tensors import GraphSize, Tensor

_PROCESS: Final = ("-m", "service.model.trial_process")
PATIENCE_S: Final = 60.0  # for a trial on a busy machine. Its processor time is limited far below that
OUT_OF_MEMORY: Final = 3  # exit status of a trial process
MAX_REMEMBERED: Final = 1000
MAX_KILLS: Final = 3  # of the process of one graph, by the kernel or for its patience. Then it is not tried again
_KILLS: Final = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)  # by others. No graph is at fault
_KEPT: Final = ("LD_LIBRARY_PATH", "LANG", "TZ")  # of the environment. The process needs none of the secrets in it
_ADDED: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "ORT_DISABLE_TELEMETRY": "1"}


def try_out(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> GraphSize:
    """Check a graph and evaluate it once, in another process. Return its size.

    Raises:
        BrokenModelError: the graph breaks a rule, or takes too much memory or time.
        RegistryError: no process can be started.
    """
    return _trials(os.getpid()).result(model, inputs, outputs)


def expect_trials() -> None:
    """Start the process of trials ahead of the first one, which then need not wait for it."""
    _trials(os.getpid()).start()


@functools.cache
def _trials(_: int) -> "Trials":
    """Return the trials of this process. One that was forked has none of its parent's."""
    trials = Trials()
    atexit.register(trials.close)
    return trials


class Trials:
    """The trial process, and the results of the graphs that were tried."""

    def __init__(self, arguments: Sequence[str] = _PROCESS, patience_s: float = PATIENCE_S) -> None:
        """Create the trials of a process.

        Args:
            arguments: those of the interpreter that start a trial process.
            patience_s: longest time of a trial on a busy machine, in s.
        """
        self._arguments = tuple(arguments)
        self._patience_s = patience_s
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._results: OrderedDict[bytes, GraphSize | str] = OrderedDict()  # size, or the reason of the refusal
        self._kills: Counter[bytes] = Counter()

    def start(self) -> None:
        """Start the trial process. If none can be started, the first trial tells the reason."""
        with self._lock, contextlib.suppress(RegistryError):
            self._running()

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
                found = self._ask(key, head, model)
                self._results[key] = found
                if len(self._results) > MAX_REMEMBERED:
                    self._results.popitem(last=False)
        if isinstance(found, str):
            raise BrokenModelError(found)
        return found

    def _ask(self, key: bytes, head: bytes, model: bytes) -> GraphSize | str:
        """Return the size of a graph, or the reason of its refusal.

        Raises:
            BrokenModelError: the process was killed. Another time the machine may have more memory, or be less busy.
            RegistryError: no process can be started, or it fails before it tries a graph.
        """
        for _ in range(2):
            process = self._running()
            answer = self._exchange(process, head, model)
            if answer:
                document = json.loads(answer)
                return document["fault"] or GraphSize(document["row_bytes"], document["context_bytes"])
            status = process.wait()
            self.close()
            if -status in _KILLS:
                reason = (
                    f"model.onnx: its trial was killed: it took more than {self._patience_s:g} s, or memory is short"
                )
                self._kills[key] += 1
                if self._kills[key] < MAX_KILLS:
                    raise BrokenModelError(reason)
                return reason
            if status == -signal.SIGXCPU:
                return "model.onnx: its trial takes more processor time than is allowed"
            if status < 0 or status == OUT_OF_MEMORY:
                return "model.onnx: its trial takes more memory than is allowed"
            if status != 0:
                break
            # The process ended for want of work in the moment in which it was asked.
        raise RegistryError(f"model.onnx: the process that tries graphs cannot work: it ended with status {status}")

    def _exchange(self, process: subprocess.Popen[bytes], head: bytes, model: bytes) -> bytes:
        """Send a graph and return the line of the answer, which is empty if the process ended."""
        watchdog = threading.Timer(self._patience_s, process.kill)
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

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._process = _start(self._arguments)
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


def _start(arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
    try:
        path = os.pathsep.join(place or str(Path.cwd()) for place in sys.path)
        process = subprocess.Popen(
            [sys.executable or "python3", "-P", "-B", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=kept | _ADDED | {"PYTHONPATH": path},
        )
    except OSError as error:
        raise RegistryError(f"model.onnx: no process to try it can be started: {error.strerror}") from error
    threading.Thread(target=process.wait, daemon=True, name="trial-end").start()  # collects its exit status
    return process


def _pipe(stream: IO[bytes] | None) -> Any:
    return stream
