"""What happened to models since the start, counted for whoever watches."""

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class Tally:
    """What happened since the start, by name of model."""

    loads: Counter[str] = field(default_factory=Counter)
    releases: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    swaps: Counter[tuple[str, str]] = field(default_factory=Counter)
    registry_failures: int = 0
    registry_up: bool = False
