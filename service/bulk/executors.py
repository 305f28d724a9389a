"""Executors of many independent tasks: this process, its threads, processes on its cores, or a Ray cluster.

A result depends on its task alone, so results are equal on every executor and with any number of workers. Data that
all tasks need are ``shared``: they are sent once to each process, which calls ``prepare(shared)`` once and gets the
function that runs a task. A task whose node dies is run again on another node.
"""

import importlib
import logging
import multiprocessing
import os
import pickle
import secrets
import signal
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, Final, Generic, Protocol, TypeVar

import service
from service.errors import WorkforceError

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")
RETRIES: Final = 10  # of a task whose node or process died; bounded, because a task may kill its own worker
CONNECT_TIMEOUT_S: Final = 5.0
_prepared: Final[dict[str, Callable[[Any], Any]]] = {}  # the function that runs a task in this process, by worker pool


@dataclass(frozen=True)
class WorkerPool(Generic[T, R]):
    """A running pool of workers. At most ``ahead`` tasks are submitted at a time, which bounds the memory."""

    submit: Callable[[T], Future[R]]
    ahead: int

    def in_order(self, tasks: Iterable[T]) -> Iterator[R]:
        """Run tasks and yield their results in the order of the tasks."""
        sent: deque[Future[R]] = deque()
        for task in tasks:
            sent.append(self.submit(task))
            if len(sent) > self.ahead:
                yield sent.popleft().result()
        while sent:
            yield sent.popleft().result()

    def as_completed(self, tasks: Iterable[T]) -> Iterator[tuple[T, R]]:
        """Run tasks and yield each with its result as soon as it is completed."""
        sent: dict[Future[R], T] = {}
        for task in tasks:
            sent[self.submit(task)] = task
            if len(sent) > self.ahead:
                yield from _completed(sent)
        while sent:
            yield from _completed(sent)


def _completed(sent: dict[Future[R], T]) -> Iterator[tuple[T, R]]:
    """Wait for at least one task, then remove and yield all completed ones."""
    done, _ = wait(sent, return_when=FIRST_COMPLETED)
    for future in done:
        yield sent.pop(future), future.result()


class Executor(Protocol):
    """A way to run tasks. See the module.

    Attributes:
        description: the executor in words, such as ``4 jobs``.
        serial: tasks run one after the other, in this process.
        shares_disk: workers see the files of this process.
    """

    description: str
    serial: bool
    shares_disk: bool

    def start(self, prepare: Callable[[S], Callable[[T], R]], shared: S) -> AbstractContextManager[WorkerPool[T, R]]:
        """Start a pool of workers. On leaving the context it is stopped, and unfinished tasks are dropped.

        Raises:
            WorkforceError: the workers cannot be started, or were lost.
        """
        ...


class SerialExecutor:
    """Runs one task after the other in this process."""

    description = "1 job"
    serial = True
    shares_disk = True

    @contextmanager
    def start(self, prepare: Callable[[S], Callable[[T], R]], shared: S) -> Iterator[WorkerPool[T, R]]:
        """See ``Executor.start``."""
        work = prepare(shared)

        def submit(task: T) -> Future[R]:
            future: Future[R] = Future()
            future.set_result(work(task))
            return future

        yield WorkerPool(submit, ahead=0)


class ThreadExecutor:
    """Runs tasks in threads of this process, for work that releases the interpreter lock. No data are copied."""

    serial = False
    shares_disk = True

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self.description = f"{jobs} job{'s' * (jobs > 1)}"

    @contextmanager
    def start(self, prepare: Callable[[S], Callable[[T], R]], shared: S) -> Iterator[WorkerPool[T, R]]:
        """See ``Executor.start``."""
        work = prepare(shared)
        threads = ThreadPoolExecutor(self._jobs)
        try:
            yield WorkerPool(lambda task: threads.submit(work, task), ahead=2 * self._jobs)
        finally:
            threads.shutdown(cancel_futures=True)


class ProcessExecutor:
    """Runs tasks in processes on this machine. They are spawned, because forking breaks the threads of torch."""

    serial = False
    shares_disk = True

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self.description = f"{jobs} jobs"

    @contextmanager
    def start(self, prepare: Callable[[S], Callable[[T], R]], shared: S) -> Iterator[WorkerPool[T, R]]:
        """See ``Executor.start``."""
        others = set(multiprocessing.active_children())
        payload = pickle.dumps((prepare, shared))
        processes = ProcessPoolExecutor(self._jobs, multiprocessing.get_context("spawn"), _prepare_process, (payload,))
        try:
            yield WorkerPool(lambda task: processes.submit(_run_in_process, task), ahead=2 * self._jobs)
            processes.shutdown()
        except BrokenProcessPool as error:
            raise WorkforceError(
                f"one of {self.description} ended abruptly, perhaps because memory ran out; try again with fewer --jobs"
            ) from error
        finally:
            processes.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - others:
                child.kill()  # otherwise this process would wait for the task of the child
                child.join()


class RayExecutor:
    """Runs tasks of one processor each on a Ray cluster of which this machine is a node."""

    serial = False
    shares_disk = False

    def __init__(self, address: str) -> None:
        self._address = address
        self.description = f"Ray at {address}"

    @contextmanager
    def start(self, prepare: Callable[[S], Callable[[T], R]], shared: S) -> Iterator[WorkerPool[T, R]]:
        """See ``Executor.start``."""
        try:  # a large dependency, loaded only if a cluster is used
            ray = importlib.import_module("ray")
        except ImportError as error:
            raise WorkforceError("--ray needs the extra 'ray': pip install 'cazsl[ray]'") from error
        self._connect(ray)
        try:
            payload = ray.put(pickle.dumps((prepare, shared)))
            run = ray.remote(num_cpus=1, max_retries=RETRIES)(_run_on_node)
            pool = secrets.token_hex(8), service.__version__, [payload]  # a reference in a list is not resolved by Ray
            processors = int(ray.cluster_resources().get("CPU", 1))
            yield WorkerPool(lambda task: run.remote(*pool, task).future(), ahead=2 * max(processors, 1))
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None  # the task's own error, as if it had run in this process
        except ray.exceptions.RayError as error:
            raise WorkforceError(
                f"the Ray cluster at {self._address} failed ({type(error).__name__}: {str(error).splitlines()[0]}); "
                "every node needs this version of cazsl with the same extras"
            ) from error
        finally:
            ray.shutdown()

    def _connect(self, ray: Any) -> None:
        host, _, port = self._address.rpartition(":")
        try:
            if host and port.isdecimal():  # fails in seconds, where Ray would retry for minutes
                socket.create_connection((host, int(port)), CONNECT_TIMEOUT_S).close()
            ray.init(address=self._address, log_to_driver=False, logging_level=logging.ERROR)
        except (OSError, RuntimeError, ValueError, ImportError, OverflowError) as error:
            raise WorkforceError(
                f"--ray: no Ray cluster answers at {self._address}; give auto or the HOST:PORT of a head node, on a "
                "machine that `ray start` has joined to the cluster"
            ) from error


def choose_executor(jobs: int, ray_address: str | None = None) -> Executor:
    """Return an executor on the cluster at this address, or on this machine. One job runs in this process."""
    if ray_address is not None:
        return RayExecutor(ray_address)
    return SerialExecutor() if jobs == 1 else ProcessExecutor(jobs)


def _prepare_process(payload: bytes) -> None:
    """Prepare a local process. It ends when its parent ends or is killed, and leaves Ctrl-C to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    prepare, shared = pickle.loads(payload)  # noqa: S301  # from the parent process
    _prepared[""] = prepare(shared)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_in_process(task: Any) -> Any:
    return _prepared[""](task)


def _run_on_node(pool: str, version: str, payload: list[Any], task: Any) -> Any:
    """Run a task on a node of a Ray cluster. The first task of a worker pool prepares the process."""
    if pool not in _prepared:
        if version != service.__version__:
            raise WorkforceError(
                f"a node of the cluster runs cazsl {service.__version__}, but this task was sent by {version}; "
                "install the same version on every node"
            )
        os.environ["CUDA_VISIBLE_DEVICES"] = ""  # tasks run on one processor and no GPU, but Ray hides no GPU
        content: bytes = importlib.import_module("ray").get(payload[0])
        prepare, shared = pickle.loads(content)  # noqa: S301  # from the process that started this pool
        _prepared.clear()  # frees the data of an earlier pool
        _prepared[pool] = prepare(shared)
    return _prepared[pool](task)
