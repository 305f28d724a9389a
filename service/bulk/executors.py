"""Whoever does many independent pieces of work: this process or its threads, processes on its cores, or a Ray cluster.

A piece's result depends on the piece alone, so results are equal wherever they are made and however many make them.
What all pieces need is ``shared``: it is sent once to each process, which calls ``prepare(shared)`` once and gets the
function that does a piece. A piece whose node dies is done again on another.
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
P = TypeVar("P")
R = TypeVar("R")
RETRIES: Final = 10  # of a piece whose node or process died; one that kills whatever does it must end some time
REACH_S: Final = 5.0
_ready: Final[dict[str, Callable[[Any], Any]]] = {}  # what this process was prepared for, by the crew that it serves


@dataclass(frozen=True)
class Crew(Generic[P, R]):
    """Those who are at work; ``ahead`` pieces are with them at once, so that nobody waits and memory is bounded."""

    submit: Callable[[P], Future[R]]
    ahead: int

    def in_order(self, pieces: Iterable[P]) -> Iterator[R]:
        """The results, in the order of the pieces."""
        sent: deque[Future[R]] = deque()
        for piece in pieces:
            sent.append(self.submit(piece))
            if len(sent) > self.ahead:
                yield sent.popleft().result()
        while sent:
            yield sent.popleft().result()

    def as_finished(self, pieces: Iterable[P]) -> Iterator[tuple[P, R]]:
        """Each piece with its result, as soon as that is there."""
        sent: dict[Future[R], P] = {}
        for piece in pieces:
            sent[self.submit(piece)] = piece
            if len(sent) > self.ahead:
                yield from _finished(sent)
        while sent:
            yield from _finished(sent)


def _finished(sent: dict[Future[R], P]) -> Iterator[tuple[P, R]]:
    """Wait for at least one, and let go of those that are there."""
    done, _ = wait(sent, return_when=FIRST_COMPLETED)
    for future in done:
        yield sent.pop(future), future.result()


class Workforce(Protocol):
    """See the module.

    Attributes:
        words: who it is, for people.
        here: pieces are done in this very process, one after the other.
        shares_disk: whoever does a piece sees the files that this process sees.
    """

    words: str
    here: bool
    shares_disk: bool

    def at_work(self, prepare: Callable[[S], Callable[[P], R]], shared: S) -> AbstractContextManager[Crew[P, R]]:
        """Call the crew together, and send it home; what it was doing then is dropped.

        Raises:
            WorkforceError: it cannot be had, or was lost.
        """
        ...


class ThisProcess:
    """One piece after the other, here."""

    words = "1 job"
    here = True
    shares_disk = True

    @contextmanager
    def at_work(self, prepare: Callable[[S], Callable[[P], R]], shared: S) -> Iterator[Crew[P, R]]:
        """See ``Workforce.at_work``."""
        work = prepare(shared)

        def submit(piece: P) -> Future[R]:
            future: Future[R] = Future()
            future.set_result(work(piece))
            return future

        yield Crew(submit, ahead=0)


class LocalThreads:
    """Threads of this process, for work that is mostly done outside of Python: nothing is started or copied."""

    here = False
    shares_disk = True

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self.words = f"{jobs} job{'s' * (jobs > 1)}"

    @contextmanager
    def at_work(self, prepare: Callable[[S], Callable[[P], R]], shared: S) -> Iterator[Crew[P, R]]:
        """See ``Workforce.at_work``."""
        work = prepare(shared)
        pool = ThreadPoolExecutor(self._jobs)
        try:
            yield Crew(lambda piece: pool.submit(work, piece), ahead=2 * self._jobs)
        finally:
            pool.shutdown(cancel_futures=True)


class LocalCores:
    """Processes on this machine, started afresh rather than forked: torch and onnxruntime have threads."""

    here = False
    shares_disk = True

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self.words = f"{jobs} jobs"

    @contextmanager
    def at_work(self, prepare: Callable[[S], Callable[[P], R]], shared: S) -> Iterator[Crew[P, R]]:
        """See ``Workforce.at_work``."""
        others = set(multiprocessing.active_children())
        parcel = pickle.dumps((prepare, shared))
        pool = ProcessPoolExecutor(self._jobs, multiprocessing.get_context("spawn"), _begin, (parcel,))
        try:
            yield Crew(lambda piece: pool.submit(_do_here, piece), ahead=2 * self._jobs)
            pool.shutdown()
        except BrokenProcessPool as error:
            raise WorkforceError(
                f"one of {self.words} ended abruptly, as when memory runs out; try again with fewer --jobs"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - others:
                child.kill()  # otherwise this process would wait for what it is doing
                child.join()


class RayCluster:
    """Tasks of one processor each on a Ray cluster of which this machine is a node."""

    here = False
    shares_disk = False

    def __init__(self, address: str) -> None:
        self._address = address
        self.words = f"Ray at {address}"

    @contextmanager
    def at_work(self, prepare: Callable[[S], Callable[[P], R]], shared: S) -> Iterator[Crew[P, R]]:
        """See ``Workforce.at_work``."""
        try:  # a dependency that only those pay who have a cluster
            ray = importlib.import_module("ray")
        except ImportError as error:
            raise WorkforceError("--ray needs the extra 'ray': pip install 'cazsl[ray]'") from error
        self._connect(ray)
        try:
            parcel = ray.put(pickle.dumps((prepare, shared)))
            task = ray.remote(num_cpus=1, max_retries=RETRIES)(_do_there)
            crew = secrets.token_hex(8), service.__version__, [parcel]  # in a list a reference stays one
            processors = int(ray.cluster_resources().get("CPU", 1))
            yield Crew(lambda piece: task.remote(*crew, piece).future(), ahead=2 * max(processors, 1))
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None  # what went wrong there, as if it had here
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
            if host and port.isdecimal():  # Ray itself would try for minutes
                socket.create_connection((host, int(port)), REACH_S).close()
            ray.init(address=self._address, log_to_driver=False, logging_level=logging.ERROR)
        except (OSError, RuntimeError, ValueError, ImportError, OverflowError) as error:
            raise WorkforceError(
                f"--ray: received {self._address}, where no Ray cluster answers; accepted is auto or the HOST:PORT of "
                "a head node, on a machine that `ray start` made a node of it"
            ) from error


def gather(jobs: int, ray_address: str | None = None) -> Workforce:
    """The cluster at this address, or that many local processes: for one job this one."""
    if ray_address is not None:
        return RayCluster(ray_address)
    return ThisProcess() if jobs == 1 else LocalCores(jobs)


def _begin(parcel: bytes) -> None:
    """Prepare a local process: it ends with its parent, however that ends, and leaves Ctrl-C to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    prepare, shared = pickle.loads(parcel)  # noqa: S301  # from our own parent
    _ready[""] = prepare(shared)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _do_here(piece: Any) -> Any:
    return _ready[""](piece)


def _do_there(crew: str, version: str, parcel: list[Any], piece: Any) -> Any:
    """A task of Ray: its process is prepared by the first piece of a crew."""
    if crew not in _ready:
        if version != service.__version__:
            raise WorkforceError(
                f"a node of the cluster has cazsl {service.__version__}; accepted is {version}, as here"
            )
        os.environ["CUDA_VISIBLE_DEVICES"] = ""  # a task is given one processor and no card, and Ray hides none
        content: bytes = importlib.import_module("ray").get(parcel[0])
        prepare, shared = pickle.loads(content)  # noqa: S301  # from the process that called this crew together
        _ready.clear()  # of a crew before this one
        _ready[crew] = prepare(shared)
    return _ready[crew](piece)
