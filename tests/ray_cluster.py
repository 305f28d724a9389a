"""A Ray cluster of two nodes on this machine, and an executor that loses one of them while it runs tasks."""

import importlib
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from service.bulk.executors import RayExecutor, WorkerPool

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")
POLLS = 3000
POLL_S = 0.02
NODE: Final[dict[str, Any]] = {
    "num_cpus": 1,
    "node_ip_address": "127.0.0.1",
    "object_store_memory": 80 * 2**20,
    "include_dashboard": False,
}
# Ray reports no usage, and allows a cluster on this machine alone, which it does not by default on Linux. Its workers
# run at normal priority: at Ray's default niceness of 15 they nearly stop on a busy machine.
ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_worker_niceness": "0",
}


class TwoNodes:
    """A Ray cluster with a head node and a second node, of one processor each. The second node may be lost."""

    def __init__(self) -> None:
        # imported by name: the import takes seconds and has no types, and only tests with a cluster need it
        self._cluster = importlib.import_module("ray.cluster_utils").Cluster(initialize_head=True, head_node_args=NODE)
        self._second: Any = None
        self.address: str = self._cluster.address

    def complete(self) -> None:
        """Add the second node if it is missing."""
        if self._second is None:
            self._second = self._cluster.add_node(**NODE)

    def lose_one(self) -> None:
        """Kill the second node with its workers."""
        self._cluster.remove_node(self._second, allow_graceful=False)
        self._second = None

    def close(self) -> None:
        """Shut down both nodes."""
        self._cluster.shutdown()


class NodeLossExecutor(RayExecutor):
    """An executor that blocks two tasks, one on each node, kills one of the nodes and lets the other tasks continue."""

    def __init__(self, cluster: TwoNodes, folder: Path, held: int) -> None:
        super().__init__(cluster.address)
        self._cluster, self._folder, self._held = cluster, folder, held

    @contextmanager
    def start(self, prepare: Callable[[S], Callable[[T], R]], shared: S) -> Iterator[WorkerPool[T, R]]:
        """Start the pool of the parent class, with tasks that carry their number."""
        with super().start(prepare_blocking, (prepare, shared, self._folder, self._held)) as pool:
            numbers = iter(range(10**6))

            def submit(task: T) -> Future[Any]:
                number = next(numbers)
                if number == self._held + 2:
                    wait_for(lambda: all(map(self._processes, (self._held, self._held + 1))))
                    processes = self._processes(self._held) + self._processes(self._held + 1)
                    self._cluster.lose_one()
                    wait_for(lambda: any(map(ended, processes)))  # a worker outlives its node by a moment
                    (self._folder / "go").touch()
                return pool.submit((number, task))

            yield WorkerPool(submit, pool.ahead)

    def run_twice(self) -> int:
        """Return the number of blocked tasks that were started a second time."""
        return sum(len(self._processes(number)) == 2 for number in (self._held, self._held + 1))

    def _processes(self, number: int) -> list[int]:
        """Return the ids of the processes that started a task."""
        return [int(path.name.rpartition("-")[2]) for path in self._folder.glob(f"{number}-*")]


def prepare_blocking(shared: tuple[Callable[[Any], Callable[[Any], Any]], Any, Path, int]) -> Callable[[Any], Any]:
    """Prepare a node: each started task leaves a file, and two of the tasks wait until the file ``go`` appears."""
    prepare, inner, folder, held = shared
    work = prepare(inner)

    def run(numbered: tuple[int, Any]) -> Any:
        number, task = numbered
        (folder / f"{number}-{os.getpid()}").touch()
        if number in (held, held + 1):
            wait_for((folder / "go").exists)
        return work(task)

    return run


def ended(pid: int) -> bool:
    """Return whether a process has ended. A zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def wait_for(event: Callable[[], bool]) -> None:
    """Poll until an event occurs, for a minute at most."""
    for _ in range(POLLS):
        if event():
            return
        time.sleep(POLL_S)
    raise AssertionError("the event did not occur within a minute")
