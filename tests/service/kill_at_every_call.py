"""Program that repeats one change of a registry and kills it with SIGKILL, each time one system call later.

    python kill_at_every_call.py REGISTRY ACTION

Each round forks a child that makes the change on a fresh copy and is killed before its n-th system call, until a child
finishes. After each kill the copy is read, then the next change is made, and all promises of a storage are checked.
Prints one line per round: exit status, versions, champion.
"""

import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from service.registry.registry import Registry
from tests.fakes import publish_fake

NAME = "push-indicator"
SYSTEM_MODULES = {"posix", "fcntl"}
ACTIONS: dict[str, Callable[[Registry], object]] = {
    "publish": lambda registry: publish_fake(registry, alias=None),
    "alias": lambda registry: registry.point_alias(NAME, "champion", 2),
    "new-alias": lambda registry: registry.point_alias(NAME, "canary", 2),
    "drop-alias": lambda registry: registry.drop_alias(NAME, "champion"),
    "remove": lambda registry: registry.remove(NAME, 2),
    "first-publish": lambda registry: publish_fake(registry, "push-none", alias=None),
}


class Killer:
    """A profiler that kills the process before its n-th system call."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """Count a system call, and kill the process if it is the n-th."""
        if event == "c_call" and getattr(argument, "__module__", None) in SYSTEM_MODULES:
            self.left -= 1
            if self.left == 0:
                sys.setprofile(None)
                os.kill(os.getpid(), signal.SIGKILL)


def change(root: Path, action: str, calls: int) -> int:
    """Make a change in a child that is killed at a call. Return the exit code of the child."""
    child = os.fork()
    if child == 0:
        sys.setprofile(Killer(calls))
        ACTIONS[action](Registry(root))
        sys.setprofile(None)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def check_state(registry: Registry) -> tuple[list[int], int]:
    """Check that every visible version verifies and every alias names one. Return the versions and the champion."""
    for name in registry.names():
        state = registry.state(name)
        for version in state.versions:
            assert registry.read(name, version).model == b"fine", f"{name}@{version}"
        assert set(state.aliases.values()) <= state.versions
    return registry.versions(NAME), registry.aliases(NAME).get("champion", 0)


def check_next_change(registry: Registry, highest: int) -> None:
    """Publish once more, and check that numbers, history and staging are in order afterwards."""
    names = registry.names()
    for name in names:
        removed = registry.state(name).removed
        version = publish_fake(registry, name, alias=None)
        assert version > highest if name == NAME else version >= 1
        history = registry.history(name)
        assert registry.unrecorded(name) == ()
        assert history.problems == ()
        published = [event.to for event in history.events if event.what == "publish"]
        assert len(published) == len(set(published))
        assert not list((registry.root / name).glob(".staging-*"))
        for number in removed:
            assert [entry.name for entry in (registry.root / name / "removed" / str(number)).iterdir()] == [
                "manifest.json"
            ]


def main() -> None:
    """Run rounds until a child finishes."""
    root, action = Path(sys.argv[1]), sys.argv[2]
    highest = max(Registry(root).versions(NAME))
    for calls in range(1, 10_000):
        copy = root.with_name(f"copy-{calls}")
        shutil.copytree(root, copy)
        status = change(copy, action, calls)
        registry = Registry(copy)
        versions, champion = check_state(registry)
        check_next_change(registry, max([highest, *versions]))
        print(status, ",".join(map(str, versions)), champion, flush=True)  # noqa: T201
        shutil.rmtree(copy)
        if status == 0:
            return


main()
