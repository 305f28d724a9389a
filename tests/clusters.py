"""A Ray cluster of two nodes on this machine, and a workforce that loses one of them while it is at work."""

import importlib
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from service.bulk.executors import Crew, RayCluster

S = TypeVar("S")
P = TypeVar("P")
R = TypeVar("R")
LOOKS = 3000
LOOK_S = 0.02
NODE: Final[dict[str, Any]] = {
    "num_cpus": 1,
    "node_ip_address": "127.0.0.1",
    "object_store_memory": 80 * 2**20,
    "include_dashboard": False,
}
# no reports to Ray's makers; a cluster of this machine alone, which Ray knows on other systems only; and workers that
# give way to nobody: beside busy processes Ray's own niceness (15) all but stops them
ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_worker_niceness": "0",
}


class TwoNodes:
    """A head with one processor, and for as long as it lives a second node with another."""

    def __init__(self) -> None:
        # by its name, since it takes seconds and has no types; only tests with a cluster pay for it
        self._cluster = importlib.import_module("ray.cluster_utils").Cluster(initialize_head=True, head_node_args=NODE)
        self._second: Any = None
        self.address: str = self._cluster.address

    def complete(self) -> None:
        """See to it that there are two."""
        if self._second is None:
            self._second = self._cluster.add_node(**NODE)

    def lose_one(self) -> None:
        """Kill the second node and all that it does."""
        self._cluster.remove_node(self._second, allow_graceful=False)
        self._second = None

    def close(self) -> None:
        """End both."""
        self._cluster.shutdown()


class LosesNode(RayCluster):
    """Holds up two pieces, one on each node, kills one of the nodes and lets the others go on."""

    def __init__(self, cluster: TwoNodes, folder: Path, held: int) -> None:
        super().__init__(cluster.address)
        self._cluster, self._folder, self._held = cluster, folder, held

    @contextmanager
    def at_work(self, prepare: Callable[[S], Callable[[P], R]], shared: S) -> Iterator[Crew[P, R]]:
        """As its parent; pieces travel with their number."""
        with super().at_work(held_up, (prepare, shared, self._folder, self._held)) as crew:
            numbers = iter(range(10**6))

            def submit(piece: P) -> Future[Any]:
                number = next(numbers)
                if number == self._held + 2:
                    wait_for(lambda: all(map(self._doers, (self._held, self._held + 1))))
                    doers = self._doers(self._held) + self._doers(self._held + 1)
                    self._cluster.lose_one()
                    wait_for(lambda: any(map(ended, doers)))  # a worker outlives its node by a moment
                    (self._folder / "go").touch()
                return crew.submit((number, piece))

            yield Crew(submit, crew.ahead)

    def done_twice(self) -> int:
        """How many of the two that were held up were begun a second time."""
        return sum(len(self._doers(place)) == 2 for place in (self._held, self._held + 1))

    def _doers(self, number: int) -> list[int]:
        """The processes that began a piece."""
        return [int(path.name.rpartition("-")[2]) for path in self._folder.glob(f"{number}-*")]


def held_up(shared: tuple[Callable[[Any], Callable[[Any], Any]], Any, Path, int]) -> Callable[[Any], Any]:
    """On the nodes: leave a mark for each piece that is begun, and wait with two of them for the word to go on."""
    prepare, inner, folder, held = shared
    work = prepare(inner)

    def do(numbered: tuple[int, Any]) -> Any:
        number, piece = numbered
        (folder / f"{number}-{os.getpid()}").touch()
        if number in (held, held + 1):
            wait_for((folder / "go").exists)
        return work(piece)

    return do


def ended(pid: int) -> bool:
    """Whether a process is no more, or is a corpse that its parent has not buried."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def wait_for(event: Callable[[], bool]) -> None:
    """Look until it is so, for a minute."""
    for _ in range(LOOKS):
        if event():
            return
        time.sleep(LOOK_S)
    raise AssertionError("it never came to be")
