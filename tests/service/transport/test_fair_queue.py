"""The fair queue gives turns by the time that callers have had, and memory to as many jobs as have room."""

import pytest

from service.errors import OverloadedError
from service.transport.fair_queue import MAX_PAUSED, FairQueue, Job


def queue(workers: int = 1, max_waiting: int = 100, max_bytes: int = 100) -> FairQueue[Job]:
    """Create a queue."""
    return FairQueue(workers, max_waiting, max_bytes)


def added(jobs: FairQueue[Job], *callers: str, size: int = 0) -> list[Job]:
    """Add a job of each of these callers."""
    found = [Job(caller, size) for caller in callers]
    for job in found:
        jobs.add(job)
    return found


def turns(jobs: FairQueue[Job], parts: int, used_s: float = 1.0) -> str:
    """Give turns until no job is left, each job being done after this many, and return their callers in order."""
    given: list[str] = []
    had: dict[Job, int] = {}
    while (job := jobs.take()) is not None:
        given.append(job.caller)
        had[job] = had.get(job, 0) + 1
        if had[job] == parts:
            jobs.finish(job, used_s)
        else:
            jobs.pause(job, used_s, 0)
    return "".join(given)


def test_turns_go_round_the_callers() -> None:
    """A caller with one job does not wait for the many jobs of another."""
    jobs = queue()
    added(jobs, *"aaaab")
    assert turns(jobs, parts=2) == "ababaaaaaa"
    assert jobs.jobs == 0


def test_one_caller_is_served_in_the_order_of_arrival() -> None:
    """A job of a single caller works to its end before the next one begins: pauses cost nothing."""
    jobs = queue()
    first, second = added(jobs, "a", "a")
    order = []
    for _ in range(3):
        job = jobs.take()
        assert job is not None
        order.append(job)
        jobs.pause(job, 1.0, 0)
    assert order == [first] * 3
    jobs.drop(first)
    jobs.finish(first, 0.0)
    assert jobs.take() is second


def test_expensive_turns_are_paid_for() -> None:
    """A caller whose turns take ten times as long gets one for ten of the other."""
    jobs = queue()
    added(jobs, *"a" * 3, *"b" * 30)
    given = ""
    while (job := jobs.take()) is not None:
        given += job.caller
        jobs.finish(job, 10.0 if job.caller == "a" else 1.0)
    assert given == "ab" + "b" * 9 + "a" + "b" * 10 + "a" + "b" * 10


def test_idleness_is_not_saved_up() -> None:
    """A caller that comes late is put equal with the others. It is not served alone until it has had as much."""
    jobs = queue()
    added(jobs, *"aaaaaa")
    for _ in range(3):
        job = jobs.take()
        assert job is not None
        jobs.finish(job, 5.0)
    added(jobs, *"bbb")
    assert turns(jobs, parts=1) == "ababab"


def test_all_workers_are_given_work() -> None:
    """With a single caller every worker has a job while there is one."""
    jobs = queue(workers=3)
    added(jobs, *"aaaa")
    assert [job.caller for job in iter(jobs.take, None)] == ["a", "a", "a"]


def test_a_job_begins_once_there_is_room() -> None:
    """A large job waits for room, others do not overtake it, and begun jobs go on and make room."""
    jobs = queue(workers=3)
    (holding,) = added(jobs, "a", size=60)
    assert jobs.take() is holding
    (large,) = added(jobs, "b", size=50)
    added(jobs, "c", size=1)
    assert jobs.take() is None
    jobs.pause(holding, 1.0, 0)
    assert jobs.take() is holding
    jobs.finish(holding, 1.0)
    assert jobs.take() is large


def test_a_job_larger_than_all_room_works_alone() -> None:
    """A job that is larger than the limit begins once no other has begun, and then others wait."""
    jobs = queue(workers=2)
    (small,) = added(jobs, "a", size=10)
    assert jobs.take() is small
    (huge,) = added(jobs, "b", size=1000)
    assert jobs.take() is None
    jobs.finish(small, 1.0)
    assert jobs.take() is huge
    added(jobs, "c", size=1)
    assert jobs.take() is None


def test_a_pause_asks_for_the_memory_of_the_next_part() -> None:
    """The next turn of a job begins once there is room for its next part, or if nothing else works."""
    jobs = queue(workers=2)
    first, second = added(jobs, "a", "b", size=10)
    assert {jobs.take(), jobs.take()} == {first, second}
    jobs.pause(first, 1.0, 85)
    assert jobs.take() is None  # 10 of the second job and 95 are too much
    jobs.pause(second, 2.0, 0)
    assert jobs.take() is first
    assert jobs.take() is None
    jobs.pause(first, 9.0, 0)
    assert {jobs.take(), jobs.take()} == {first, second}


def test_a_number_of_jobs_may_pause() -> None:
    """However many callers there are, a bounded number of jobs has begun."""
    jobs = queue(workers=2)
    added(jobs, *(str(number) for number in range(50)))
    begun = set()
    for _ in range(200):
        job = jobs.take()
        assert job is not None
        begun.add(job)
        jobs.pause(job, 1.0, 0)
    assert len(begun) == 2 + MAX_PAUSED


def test_a_full_queue_drops_a_job_of_the_caller_with_the_most() -> None:
    """A newcomer gets a place from the caller that has the most jobs waiting, whose newest job is dropped."""
    jobs = queue(max_waiting=3)
    *_, newest = added(jobs, *"aaaa")
    jobs.take()
    assert jobs.add(Job("b", 0)) is newest
    assert newest.finished
    with pytest.raises(OverloadedError):
        jobs.add(Job("b", 0))
    with pytest.raises(OverloadedError):
        jobs.add(Job("a", 0))
    assert jobs.jobs == 4


def test_a_caller_is_forgotten_with_its_last_job() -> None:
    """Addresses that never come back take no memory, whether their jobs ended or were dropped."""
    jobs = queue()
    for number in range(100):
        waiting, working = added(jobs, str(number), str(number))
        jobs.take()
        jobs.drop(working if waiting.working else waiting)
        jobs.finish(waiting if waiting.working else working, 1.0)
    assert jobs.jobs == 0
    assert jobs.every() == []
    assert not jobs._callers
