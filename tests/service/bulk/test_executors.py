"""Tests of all executors: equal results in order, unchanged errors, and no worker left behind."""

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.bulk.executors import (
    Executor,
    ProcessExecutor,
    RayExecutor,
    SerialExecutor,
    ThreadExecutor,
    choose_executor,
)
from service.errors import FieldFault, InvalidRequestError, WorkforceError
from tests.ray_cluster import TwoNodes, ended, wait_for


def power(exponent: int) -> Callable[[int], int]:
    """Prepare short tasks, of which 13 raises an error and 99 kills its worker."""

    def work(task: int) -> int:
        if task == 13:
            raise InvalidRequestError.at("task", "13", "any other number")
        if task == 99:
            os.kill(os.getpid(), signal.SIGKILL)
        return int(task**exponent)

    return work


def sleep(_: int) -> Callable[[Path], None]:
    """Prepare tasks that write the process id to a file and then never end."""

    def work(path: Path) -> None:
        path.with_suffix(".part").write_text(str(os.getpid()), encoding="utf-8")
        path.with_suffix(".part").replace(path)
        wait_for(lambda: False)

    return work


@pytest.fixture(
    params=[SerialExecutor(), ThreadExecutor(2), ProcessExecutor(2)],
    ids=["this process", "two threads", "two processes"],
)
def executor(request: pytest.FixtureRequest) -> Executor:
    """Every executor on this machine."""
    found: Executor = request.param
    return found


def test_in_order_yields_results_in_the_order_of_the_tasks(executor: Executor) -> None:
    """The results of a worker pool come in the order of the tasks, whatever the number of workers."""
    with executor.start(power, 2) as pool:
        assert list(pool.in_order(range(20, 40))) == [task**2 for task in range(20, 40)]


def test_as_completed_yields_each_task_with_its_result(executor: Executor) -> None:
    """Each result comes with its task, in any order of completion."""
    with executor.start(power, 3) as pool:
        assert dict(pool.as_completed(range(20, 40))) == {task: task**3 for task in range(20, 40)}


def test_number_of_submitted_tasks_is_bounded(executor: Executor) -> None:
    """A worker pool takes at most ``ahead`` tasks more than it has yielded results, so memory is bounded."""
    taken = []

    def tasks() -> Iterator[int]:
        for task in range(20, 40):
            taken.append(task)
            yield task

    with executor.start(power, 2) as pool:
        for number, _ in enumerate(pool.in_order(tasks()), start=1):
            assert len(taken) <= number + pool.ahead


def test_error_of_a_task_is_raised_unchanged(executor: Executor) -> None:
    """An error of a task is raised with its faults, and the worker processes end."""
    with pytest.raises(InvalidRequestError) as caught, executor.start(power, 2) as pool:
        list(pool.in_order([1, 2, 13, 4]))

    assert caught.value.faults == (FieldFault("task", "13", "any other number"),)
    assert str(caught.value) == "task: received 13; accepted is any other number"
    wait_for(lambda: not multiprocessing.active_children())  # the pool's own thread notices their end as well


def test_killed_worker_is_an_error_with_advice() -> None:
    """A killed worker process, as when memory runs out, is a WorkforceError that recommends fewer jobs."""
    with (
        pytest.raises(WorkforceError, match=r"ended abruptly.*fewer --jobs"),
        ProcessExecutor(2).start(power, 2) as pool,
    ):
        list(pool.in_order([1, 2, 99, 4]))


def test_interrupted_pool_kills_its_workers(tmp_path: Path) -> None:
    """An interrupt ends the worker processes at once, even in the middle of a task."""

    def interrupted() -> Iterator[Path]:
        yield tmp_path / "pid"
        wait_for((tmp_path / "pid").exists)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), ProcessExecutor(1).start(sleep, 0) as pool:
        list(pool.in_order(interrupted()))

    pid = int((tmp_path / "pid").read_text(encoding="utf-8"))
    wait_for(lambda: ended(pid))


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path, project_root: Path) -> None:
    """Worker processes end when their parent is killed."""
    code = (
        "import sys; from pathlib import Path; from service.bulk.executors import ProcessExecutor\n"
        "from tests.service.bulk.test_executors import sleep\n"
        "if __name__ == '__main__':\n"
        "    with ProcessExecutor(1).start(sleep, 0) as pool:\n"
        "        pool.submit(Path(sys.argv[1])).result()\n"
    )
    (tmp_path / "parent.py").write_text(code, encoding="utf-8")
    parent = subprocess.Popen(
        [sys.executable, tmp_path / "parent.py", tmp_path / "pid"], env={**os.environ, "PYTHONPATH": str(project_root)}
    )
    wait_for((tmp_path / "pid").exists)
    parent.kill()
    parent.wait()

    pid = int((tmp_path / "pid").read_text(encoding="utf-8"))
    wait_for(lambda: ended(pid))


def test_error_on_a_cluster_is_raised_unchanged(ray_cluster: TwoNodes) -> None:
    """An error of a task on a Ray cluster is raised as it was, not as an error of Ray."""
    executor = RayExecutor(ray_cluster.address)
    with pytest.raises(InvalidRequestError) as caught, executor.start(power, 2) as pool:
        list(pool.in_order([1, 2, 13, 4]))

    assert caught.value.faults == (FieldFault("task", "13", "any other number"),)


@pytest.mark.parametrize(
    "address", ["127.0.0.1:1", "nonsense", "127.0.0.1:99999999"], ids=["no server", "no address", "port"]
)
def test_address_without_a_cluster_is_refused_at_once(address: str) -> None:
    """An address without a Ray cluster is a WorkforceError that names the address and the accepted ones."""
    with pytest.raises(WorkforceError, match=f"--ray: no Ray cluster answers at {address}; give auto or the HOST:PORT"):
        RayExecutor(address).start(power, 2).__enter__()


def test_executor_is_chosen_by_jobs_and_address() -> None:
    """One job runs in this process, several run in worker processes, and an address selects a Ray cluster."""
    assert choose_executor(1).serial
    assert not choose_executor(2).serial
    assert not choose_executor(1, "127.0.0.1:6379").shares_disk
