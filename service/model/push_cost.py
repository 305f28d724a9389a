"""Cost of pushes: the time that a version takes for them, as its self-check measured it on this machine.

The limits of a piece follow from it. A piece is one call of the runtime that is bounded in memory and in time.
"""

from dataclasses import dataclass
from typing import Final

from service.model.predictor import ROWS_AT_ONCE
from service.model.tensors import GraphSize

MAX_PUSHES: Final = 1024  # of a piece: with fewer the throughput falls, with more it does not rise
MAX_CONTEXTS: Final = 64
PIECE_BYTES: Final = 16 << 20  # all intermediate tensors of a piece. The runtime reuses the memory of most.
PIECE_S: Final = 0.1  # others wait for at most this long
_MANY: Final = 1 << 30
_RISE: Final = 2.0  # at most, from one measurement to the next: the machine was busy, but the graph is the same


@dataclass
class PushCost:
    """Cost of a version: the time of one call of the runtime with some pushes and contexts.

    A graph takes time for each push, for each context and for each call. ``seconds_of`` is an upper bound of the sum.

    Attributes:
        pushes: number of pushes in the call, at least 1.
        contexts: number of distinct contexts in the call, at least 1.
        call_s: time of the call, in s. Also a bound for one push with one context.
    """

    pushes: int = 1
    contexts: int = 1
    call_s: float = 0.0

    def seconds_of(self, pushes: int, contexts: int) -> float:
        """Return a bound of the time for this many pushes of this many distinct contexts, in s."""
        return self.call_s * max(1.0, pushes / self.pushes, contexts / self.contexts)

    def pushes_within(self, seconds: float) -> int:
        """Return how many pushes of one context fit in this time, at least 1."""
        return max(1, int(seconds * self.pushes / self.call_s)) if self.call_s > 0.0 else _MANY

    def contexts_within(self, seconds: float) -> int:
        """Return how many contexts with one push each fit in this time, at least 1."""
        return max(1, int(seconds * min(self.pushes, self.contexts) / self.call_s)) if self.call_s > 0.0 else _MANY

    def renew(self, call_s: float) -> None:
        """Take a later measurement of the same call. One that is far above the last counts in part."""
        self.call_s = min(call_s, _RISE * self.call_s)


@dataclass(frozen=True, slots=True)
class PieceLimits:
    """Maximum numbers of pushes and contexts in one call of the runtime."""

    pushes: int
    contexts: int

    @classmethod
    def of(cls, size: GraphSize, cost: PushCost, seconds: float = PIECE_S) -> "PieceLimits":
        """Return the limits for a graph, by the size of its tensors and its measured time, for a piece of this time."""
        pushes = min(MAX_PUSHES, PIECE_BYTES // max(1, size.row_bytes), cost.pushes_within(seconds))
        contexts = min(MAX_CONTEXTS, PIECE_BYTES // max(1, size.context_bytes), cost.contexts_within(seconds))
        return cls(max(ROWS_AT_ONCE, pushes - pushes % ROWS_AT_ONCE), max(1, contexts))
