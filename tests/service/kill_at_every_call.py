"""A program: do one change to a registry again and again, killed by SIGKILL at one more system call each time.

    python kill_at_every_call.py REGISTRY ACTION

Each round forks a child that makes the change to a fresh copy and dies right before its n-th call into the operating
system, until one gets through. After each death the copy is looked at as a reader would, then the next change is made,
and everything that was promised is checked. Prints one line per round: exit status, versions, champion.
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
SYSTEM = {"posix", "fcntl"}
ACTIONS: dict[str, Callable[[Registry], object]] = {
    "publish": lambda registry: publish_fake(registry, alias=None),
    "alias": lambda registry: registry.point_alias(NAME, "champion", 2),
    "new-alias": lambda registry: registry.point_alias(NAME, "canary", 2),
    "drop-alias": lambda registry: registry.drop_alias(NAME, "champion"),
    "remove": lambda registry: registry.remove(NAME, 2),
    "first-publish": lambda registry: publish_fake(registry, "push-none", alias=None),
}


class Killer:
    """A profiler that ends the process right before its n-th system call."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """Called by the interpreter."""
        if event == "c_call" and getattr(argument, "__module__", None) in SYSTEM:
            self.left -= 1
            if self.left == 0:
                sys.setprofile(None)
                os.kill(os.getpid(), signal.SIGKILL)


def change(root: Path, action: str, calls: int) -> int:
    """Make a change in a child that dies at a call; how the child ended."""
    child = os.fork()
    if child == 0:
        sys.setprofile(Killer(calls))
        ACTIONS[action](Registry(root))
        sys.setprofile(None)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def look(registry: Registry) -> tuple[list[int], int]:
    """What a reader sees right after the death: everything visible verifies, every alias means something."""
    for name in registry.names():
        state = registry.state(name)
        for version in state.versions:
            assert registry.read(name, version).model == b"fine", f"{name}@{version}"
        assert set(state.aliases.values()) <= state.versions
    return registry.versions(NAME), registry.aliases(NAME).get("champion", 0)


def go_on(registry: Registry, ever: int) -> None:
    """The next writer finds everything in order, or puts it in order."""
    names = registry.names()
    for name in names:
        removed = registry.state(name).removed
        version = publish_fake(registry, name, alias=None)
        assert version > ever if name == NAME else version >= 1
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
    """Round after round, until a child lives."""
    root, action = Path(sys.argv[1]), sys.argv[2]
    ever = max(Registry(root).versions(NAME))
    for calls in range(1, 10_000):
        copy = root.with_name(f"copy-{calls}")
        shutil.copytree(root, copy)
        status = change(copy, action, calls)
        registry = Registry(copy)
        versions, champion = look(registry)
        go_on(registry, max([ever, *versions]))
        print(status, ",".join(map(str, versions)), champion, flush=True)  # noqa: T201
        shutil.rmtree(copy)
        if status == 0:
            return


main()
