"""The seam below the registry: where its bytes lie, and how one change at a time becomes visible.

A storage keeps versions as sets of files, a ``ModelState`` per model (versions, aliases, spent numbers) and a history.
Its promises, which the same tests hold for every storage:

- a version is visible whole or not at all, whatever is killed, and its number is never given again;
- ``commit`` decides on the state as it is at the instant of the change: compare-and-set, for aliases and removals;
- every change has its line in the history, at the latest when the next one is made;
- reading writes nothing and believes nothing: names are checked by the registry above, sizes are bounded here.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from service.storage.history import Event, History, ModelState

MAX_SIGNATURE_BYTES: Final = 64 << 10
MAX_HISTORY_BYTES: Final = 64 << 20
Decision = Callable[[ModelState], Event]


@dataclass(frozen=True)
class Finding:
    """Something that should not be as it is: where, what is wrong, what to do; and whether serving suffers."""

    where: str
    wrong: str
    advice: str
    severe: bool = True


class Storage(Protocol):
    """A folder or a bucket."""

    def models(self) -> list[str]:
        """Every name under which a model lies, sorted.

        Raises:
            RegistryError: it cannot be told; which is not the same as none.
        """
        ...

    def state(self, name: str) -> ModelState:
        """What is visible of a model now; nothing of one that is not there.

        Raises:
            RegistryError: it cannot be told.
        """
        ...

    def files(self, name: str, version: int) -> list[str]:
        """The names of the files of a version.

        Raises:
            BrokenModelError: it is not there, or not a plain folder.
        """
        ...

    def read(self, name: str, version: int, file: str, limit: int) -> bytes:
        """A regular file of a version, of at most ``limit`` bytes.

        Raises:
            BrokenModelError: names the file and what is wrong with it.
        """
        ...

    def publish(
        self, name: str, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None = None
    ) -> int:
        """Make files visible under the next number, or under one that is asked for; its manifest is written last.

        Raises:
            ConflictError: the number that was asked for is taken or spent.
            PublishError: nothing became visible.
            RegistryError: it is visible, and could not be recorded.
        """
        ...

    def commit(self, name: str, decide: Decision) -> Event:
        """Decide on the state as it is, make the event happen, record it.

        Raises:
            RegistryError: what ``decide`` raised, or nothing happened, or it happened and could not be recorded.
        """
        ...

    def history(self, name: str) -> History:
        """What happened to a model.

        Raises:
            RegistryError: it cannot be read.
        """
        ...

    def signature(self, name: str, version: int) -> bytes | None:
        """The detached signature of a version, if it has one.

        Raises:
            BrokenModelError: it cannot be read.
        """
        ...

    def sign(self, name: str, version: int, signature: bytes) -> None:
        """Store the detached signature of a version; the version itself does not change.

        Raises:
            RegistryError: it could not be stored.
        """
        ...

    def fingerprint(self) -> Hashable:
        """Changes whenever a version, an alias or a signature does; as cheap as can be.

        Raises:
            RegistryError: it cannot be told.
        """
        ...

    def survey(self) -> Sequence[Finding]:
        """What lies here that is no part of the layout."""
        ...
