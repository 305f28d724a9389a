"""The storage protocol: where the bytes of a registry lie, and how one change at a time becomes visible.

A storage keeps versions as sets of files, a ``ModelState`` per model (versions, aliases, removed numbers) and a
history. Every storage keeps these promises, and one suite of tests runs against each of them:

- A version is visible whole or not at all, even if the writer is killed. Its number is never used again.
- ``commit`` decides on the state at the instant of the change: compare-and-set, for aliases and removals.
- Every change has its line in the history, at the latest when the next change is made.
- A fault of one model is an error for that model only.
- Reading changes no file, and a change that is made meanwhile is no fault. Sizes are bounded here. Names are checked by
  the registry above.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

from service.storage.history import Event, History, ModelState

MAX_SIGNATURE_BYTES: Final = 64 << 10
MAX_HISTORY_BYTES: Final = 64 << 20
ATTEMPTS: Final = 50  # to make one change, or to read two parts of one instant, while other writers are faster
Decision = Callable[[ModelState], Event]
Clock = TypeVar("Clock")
Part = TypeVar("Part")


@dataclass(frozen=True)
class RegistryFinding:
    """A fault of a registry.

    Attributes:
        where: the model, version, alias or file.
        wrong: the fault in words.
        advice: the next step for the operator.
        severe: predictions suffer. False for leftovers that only take space.
    """

    where: str
    wrong: str
    advice: str
    severe: bool = True


class Storage(Protocol):
    """Versions, aliases and histories of models, in a folder or in a bucket."""

    def models(self) -> list[str]:
        """Return the names of all models, sorted. Entries that are no models are left out.

        Raises:
            RegistryError: the storage cannot be listed. An empty storage is no error.
        """
        ...

    def strangers(self) -> Sequence[RegistryFinding]:
        """Return a finding for each entry beside the models that is none. It is severe if it is in a model's place.

        Raises:
            RegistryError: the storage cannot be listed.
        """
        ...

    def state(self, name: str) -> ModelState:
        """Return the visible state of a model. The state of an unknown model is empty.

        A part that cannot be read, such as one alias, is a fault in the state. The rest is read.

        Raises:
            RegistryError: no part of the state can be read.
        """
        ...

    def files(self, name: str, version: int) -> list[str]:
        """Return the names of the files of a version.

        Raises:
            BrokenModelError: the version is missing, or is not a plain folder.
        """
        ...

    def read(self, name: str, version: int, file: str, limit: int) -> bytes:
        """Read a regular file of a version.

        Raises:
            BrokenModelError: the file is missing, is not a regular file, or has more than ``limit`` bytes.
        """
        ...

    def publish(
        self, name: str, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None = None
    ) -> int:
        """Make files visible as a version and return its number. The manifest is written last.

        Args:
            name: the model.
            files: content by file name, without the manifest.
            manifest: renders the manifest for a version number.
            number: the version number to use. None uses the next free one.

        Raises:
            ConflictError: ``number`` is taken or was removed.
            PublishError: no version became visible.
            RegistryError: the version is visible, but could not be recorded.
        """
        ...

    def commit(self, name: str, decide: Decision) -> Event:
        """Call ``decide`` with the current state, apply the event that it returns, and record it.

        Errors of ``decide`` pass unchanged.

        Raises:
            RegistryError: the state is unchanged, or it changed and could not be recorded. The message tells which.
        """
        ...

    def history(self, name: str) -> History:
        """Return the history of a model.

        Raises:
            RegistryError: the history cannot be read.
        """
        ...

    def signature(self, name: str, version: int) -> bytes | None:
        """Return the detached signature of a version, or None for an unsigned version.

        Raises:
            BrokenModelError: the signature cannot be read.
        """
        ...

    def sign(self, name: str, version: int, signature: bytes) -> None:
        """Store the detached signature of a version. The version itself does not change.

        Raises:
            RegistryError: the signature could not be stored.
        """
        ...

    def fingerprint(self) -> Hashable:
        """Return a value that changes with every version, alias and signature. Cheap enough to poll.

        A model that cannot be read is part of the value, and hides no change of another one.

        Raises:
            RegistryError: the storage cannot be listed.
        """
        ...

    def survey(self) -> Sequence[RegistryFinding]:
        """Return ``strangers``, and a finding for each entry of a model that is not part of its layout.

        A model that cannot be listed is left out, because ``state`` tells the cause.

        Raises:
            RegistryError: the storage cannot be listed.
        """
        ...


def settled(clock: Callable[[], Clock], read: Callable[[], Part]) -> tuple[Clock, Part]:
    """Return two parts of a registry at one instant: ``clock``, which every change changes, was read before and after.

    A change between two reads would look like a line that is missing, or like a version that vanished.
    """
    now = clock()
    for _ in range(ATTEMPTS):
        before, part, now = now, read(), clock()
        if now == before:
            break
    return now, part
