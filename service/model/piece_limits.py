"""Limits of a piece: one call of the runtime that is bounded in memory and in time, for any version."""

from dataclasses import dataclass
from typing import Final

from service.model.predictor import ROWS_AT_ONCE
from service.model.push_cost import PushCost
from service.model.tensors import GraphSize

MAX_PUSHES: Final = 1024  # of a piece: with fewer the throughput falls, with more it does not rise
MAX_CONTEXTS: Final = 64
PIECE_BYTES: Final = 16 << 20  # all intermediate tensors of a piece. The runtime reuses the memory of most.
PIECE_S: Final = 0.1  # others wait for at most this long


@dataclass(frozen=True, slots=True)
class PieceLimits:
    """Maximum numbers of pushes and contexts in one call of the runtime."""

    pushes: int
    contexts: int

    @classmethod
    def of(cls, size: GraphSize, cost: PushCost) -> "PieceLimits":
        """Return the limits for a graph, by the size of its tensors and its measured time."""
        pushes = min(MAX_PUSHES, PIECE_BYTES // max(1, size.row_bytes), cost.pushes_within(PIECE_S))
        contexts = min(MAX_CONTEXTS, PIECE_BYTES // max(1, size.context_bytes), cost.contexts_within(PIECE_S))
        return cls(max(ROWS_AT_ONCE, pushes - pushes % ROWS_AT_ONCE), max(1, contexts))
