"""Whoever does the work: the same results in the same order, errors as they were, and nobody left behind."""

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.bulk.executors import LocalCores, LocalThreads, RayCluster, ThisProcess, Workforce, gather
from service.errors import FieldFault, InvalidRequestError, WorkforceError
from tests.clusters import TwoNodes, ended, wait_for


def power(exponent: int) -> Callable[[int], int]:
    """Work that is quick, refuses 13 and dies of 99."""

    def work(piece: int) -> int:
        if piece == 13:
            raise InvalidRequestError.at("piece", "13", "any other number")
        if piece == 99:
            os.kill(os.getpid(), signal.SIGKILL)
        return int(piece**exponent)

    return work


def sleep(_: int) -> Callable[[Path], None]:
    """Work without end, which leaves its process's number in a file."""

    def work(path: Path) -> None:
        path.with_suffix(".part").write_text(str(os.getpid()), encoding="utf-8")
        path.with_suffix(".part").replace(path)
        wait_for(lambda: False)

    return work


@pytest.fixture(
    params=[ThisProcess(), LocalThreads(2), LocalCores(2)], ids=["this process", "two threads", "two processes"]
)
def workforce(request: pytest.FixtureRequest) -> Workforce:
    """The local ones."""
    found: Workforce = request.param
    return found


def test_results_come_in_the_order_of_the_pieces(workforce: Workforce) -> None:
    """However many work on them."""
    with workforce.at_work(power, 2) as crew:
        assert list(crew.in_order(range(20, 40))) == [piece**2 for piece in range(20, 40)]


def test_each_result_comes_with_its_piece(workforce: Workforce) -> None:
    """In whatever order they are finished."""
    with workforce.at_work(power, 3) as crew:
        assert dict(crew.as_finished(range(20, 40))) == {piece: piece**3 for piece in range(20, 40)}


def test_no_more_pieces_are_taken_than_can_be_held(workforce: Workforce) -> None:
    """A file of any length goes through a memory of some length."""
    taken = []

    def pieces() -> Iterator[int]:
        for piece in range(20, 40):
            taken.append(piece)
            yield piece

    with workforce.at_work(power, 2) as crew:
        for number, _ in enumerate(crew.in_order(pieces()), start=1):
            assert len(taken) <= number + crew.ahead


def test_an_error_arrives_as_it_was_raised(workforce: Workforce) -> None:
    """With its faults, and the children are gone."""
    with pytest.raises(InvalidRequestError) as caught, workforce.at_work(power, 2) as crew:
        list(crew.in_order([1, 2, 13, 4]))

    assert caught.value.faults == (FieldFault("piece", "13", "any other number"),)
    assert str(caught.value) == "piece: received 13; accepted is any other number"
    wait_for(lambda: not multiprocessing.active_children())  # the pool's own thread notices their end as well


def test_a_worker_that_is_killed_is_told_of() -> None:
    """As when memory runs out; with what to do."""
    with pytest.raises(WorkforceError, match=r"ended abruptly.*fewer --jobs"), LocalCores(2).at_work(power, 2) as crew:
        list(crew.in_order([1, 2, 99, 4]))


def test_an_interrupted_crew_is_sent_home(tmp_path: Path) -> None:
    """What it is doing does not hold anybody up."""

    def interrupted() -> Iterator[Path]:
        yield tmp_path / "pid"
        wait_for((tmp_path / "pid").exists)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), LocalCores(1).at_work(sleep, 0) as crew:
        list(crew.in_order(interrupted()))

    pid = int((tmp_path / "pid").read_text(encoding="utf-8"))
    wait_for(lambda: ended(pid))


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path, project_root: Path) -> None:
    """Even where it has no chance to say so."""
    code = (
        "import sys; from pathlib import Path; from service.bulk.executors import LocalCores\n"
        "from tests.service.test_workforce import sleep\n"
        "if __name__ == '__main__':\n"
        "    with LocalCores(1).at_work(sleep, 0) as crew:\n"
        "        crew.submit(Path(sys.argv[1])).result()\n"
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


def test_an_error_on_a_cluster_arrives_as_it_was_raised(ray_cluster: TwoNodes) -> None:
    """Not as one of Ray."""
    workforce = RayCluster(ray_cluster.address)
    with pytest.raises(InvalidRequestError) as caught, workforce.at_work(power, 2) as crew:
        list(crew.in_order([1, 2, 13, 4]))

    assert caught.value.faults == (FieldFault("piece", "13", "any other number"),)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nonsense", "127.0.0.1:99999999"], ids=["nobody", "none", "port"])
def test_an_address_without_a_cluster_is_told_at_once(address: str) -> None:
    """With what would be accepted."""
    with pytest.raises(WorkforceError, match=f"--ray: received {address}, where no Ray cluster answers; accepted is"):
        RayCluster(address).at_work(power, 2).__enter__()


def test_one_job_needs_no_other_process() -> None:
    """And an address means a cluster."""
    assert gather(1).here
    assert not gather(2).here
    assert not gather(1, "127.0.0.1:6379").shares_disk
