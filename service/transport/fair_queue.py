"""Fair queue: decides which job of which caller works next, by the time that its caller has had and the room for it.

The next turn is of the caller that has had the least time. A caller that comes is put equal with the one that had the
least, so idleness is not saved up. Turns of one caller go to its oldest job, so with a single caller jobs end in the
order in which they came. A job begins once there is room for its memory. If there is none, only jobs go on that have
begun: they end and make room. The queue has no clock, no lock and no thread.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Final, Generic, TypeVar

from service.errors import OverloadedError

MAX_PAUSED: Final = 8  # jobs that have begun and wait, beside those that work. Each may hold megabytes.


@dataclass(eq=False)
class Job:
    """A job of a caller.

    Attributes:
        caller: name of the caller.
        base_bytes: memory from its beginning to its end.
        wanted_bytes: memory that it needs for its next turn, with the base.
        held_bytes: memory that is counted for it now.
        most_bytes: the most that was counted for it.
        begun: it has had a turn.
        working: it has a turn now.
        finished: it counts no longer.
    """

    caller: str
    base_bytes: int
    wanted_bytes: int = field(init=False)
    held_bytes: int = field(init=False, default=0)
    most_bytes: int = field(init=False, default=0)
    begun: bool = field(init=False, default=False)
    working: bool = field(init=False, default=False)
    finished: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        """Want the memory of the whole job at first."""
        self.wanted_bytes = self.base_bytes


J = TypeVar("J", bound=Job)


@dataclass(eq=False)
class _Caller(Generic[J]):
    """A caller with jobs: the time that they have had, and those that wait for a turn, the oldest first."""

    used_s: float
    jobs: deque[J] = field(default_factory=deque)
    begun: int = 0

    def waiting(self) -> int:
        """Return the number of jobs that have not begun."""
        return sum(not job.begun for job in self.jobs)


class FairQueue(Generic[J]):
    """A queue of jobs that wait for turns, and the account of those that work.

    Attributes:
        jobs: number of jobs that wait, work or pause.
    """

    def __init__(self, workers: int, max_waiting: int, max_bytes: int) -> None:
        self.jobs = 0
        self._workers = workers
        self._max_jobs = workers + max_waiting
        self._max_bytes = max_bytes
        self._working = 0
        self._begun: set[J] = set()
        self._callers: dict[str, _Caller[J]] = {}

    def every(self) -> list[J]:
        """Return all jobs."""
        return [*self._begun, *(job for caller in self._callers.values() for job in caller.jobs if not job.begun)]

    def add(self, job: J) -> J | None:
        """Add a job. If the queue is full, drop and return the newest waiting job of the caller that has the most.

        Raises:
            OverloadedError: the queue is full, and no caller has more jobs than this one.
        """
        dropped = self._make_room(job.caller) if self.jobs >= self._max_jobs else None
        caller = self._callers.get(job.caller)
        if caller is None:
            least = min((other.used_s for other in self._callers.values()), default=0.0)
            caller = self._callers[job.caller] = _Caller(least)
        caller.jobs.append(job)
        self.jobs += 1
        return dropped

    def take(self) -> J | None:
        """Give the next turn to a job and return it, or return None if no worker is free or no job can go on."""
        job = self._next() if self._working < self._workers else None
        if job is None:
            return None
        caller = self._callers[job.caller]
        caller.jobs.popleft()
        caller.begun += not job.begun
        self._begun.add(job)
        self._working += 1
        job.begun = job.working = True
        job.held_bytes = job.wanted_bytes
        job.most_bytes = max(job.most_bytes, job.held_bytes)
        return job

    def pause(self, job: J, used_s: float, needed_bytes: int) -> None:
        """End the turn of a job, which took this time, and let it wait for the next."""
        self._stop(job, used_s)
        job.held_bytes, job.wanted_bytes = job.base_bytes, job.base_bytes + needed_bytes
        self._callers[job.caller].jobs.appendleft(job)

    def finish(self, job: J, used_s: float) -> None:
        """End a job that has begun."""
        if job.working:
            self._stop(job, used_s)
        self._callers[job.caller].begun -= 1
        self._begun.discard(job)
        self._forget(job)

    def drop(self, job: J) -> None:
        """Take a job that does not work out of the queue. If it has begun, it counts until it is finished."""
        self._callers[job.caller].jobs.remove(job)
        if not job.begun:
            self._forget(job)

    def _make_room(self, newcomer: str) -> J:
        most = max(self._callers.values(), key=lambda caller: caller.waiting())
        known = self._callers.get(newcomer)
        if most.waiting() <= (0 if known is None else known.waiting()) + 1:
            raise self.overloaded()
        job = most.jobs[-1]  # those that have begun are at the front
        self.drop(job)
        return job

    def overloaded(self) -> OverloadedError:
        """Return the error of a job for which there is no place."""
        return OverloadedError(f"{self._max_jobs} large batches and images")

    def _next(self) -> J | None:
        may_begin = True
        for caller in sorted((each for each in self._callers.values() if each.jobs), key=lambda each: each.used_s):
            job = caller.jobs[0]
            if (may_begin or job.begun) and self._has_room(job):
                return job
            may_begin = False
        return None

    def _has_room(self, job: J) -> bool:
        """Return whether a job may have a turn. One may at any time, since otherwise all would wait for each other."""
        others = sum(other.held_bytes for other in self._begun if other is not job)
        if job.begun:
            return not self._working or others + job.wanted_bytes <= self._max_bytes
        if len(self._begun) >= self._workers + MAX_PAUSED:
            return False
        return not self._begun or others + job.wanted_bytes <= self._max_bytes

    def _stop(self, job: J, used_s: float) -> None:
        self._callers[job.caller].used_s += used_s
        self._working -= 1
        job.working = False

    def _forget(self, job: J) -> None:
        job.finished = True
        self.jobs -= 1
        caller = self._callers[job.caller]
        if not caller.jobs and not caller.begun:
            del self._callers[job.caller]
