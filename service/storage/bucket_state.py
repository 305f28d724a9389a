"""Content of ``state.json`` in a bucket: the state of a model, the number of events that led to it, the last event.

It is the head of the history, too: its number and its event tell whether events are missing at the end.
"""

import json
import secrets
from dataclasses import dataclass, field
from typing import Final, Self

from service.errors import BrokenModelError
from service.model.reference import is_alias
from service.model.strict_json import check_integer, read_json
from service.storage.history import ModelState

STATE_FILE: Final = "state.json"
MAX_STATE_BYTES: Final = 4 << 20
MAX_VERSION: Final = 10**9 - 1


@dataclass(frozen=True)
class StateFile:
    """State of a model, the number of events that led to it, and the last event as a line of the history."""

    state: ModelState = field(default_factory=ModelState)
    generation: int = 0
    event: bytes = b""

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Parse the JSON document.

        Raises:
            BrokenModelError: it is not the state of a model.
        """
        try:
            document = read_json(content, MAX_STATE_BYTES)
            aliases = document["aliases"]
            if not all(is_alias(alias) for alias in aliases):
                raise ValueError("an alias with a name that is none")
            state = ModelState(
                _versions(document["versions"]),
                {alias: _version(version) for alias, version in aliases.items()},
                _versions(document["removed"]),
            )
            return cls(state, check_integer(document["generation"], 1, MAX_VERSION), document["event"].encode())
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise BrokenModelError(f"{STATE_FILE}: not the state of a model; restore it from a backup") from error

    def render(self) -> bytes:
        """Render the JSON document, and check that it can be read back.

        Raises:
            BrokenModelError: it cannot, as with too many aliases or versions.
        """
        document = {
            "versions": sorted(self.state.versions),
            "aliases": dict(sorted(self.state.aliases.items())),
            "removed": sorted(self.state.removed),
            "generation": self.generation,
            "event": self.event.decode(),
            "write": secrets.token_hex(8),  # makes the writes of two clients differ even if their content is equal
        }
        content = json.dumps(document, indent=2).encode() + b"\n"
        self.parse(content)
        return content


def _version(number: object) -> int:
    return check_integer(number, 1, MAX_VERSION)


def _versions(numbers: list[object]) -> frozenset[int]:
    return frozenset(map(_version, numbers))
