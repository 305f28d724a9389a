"""Many pushes are predicted in pieces: each is bounded, and together they are the same to the bit as one call."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from service.inference.pieces import predict_in_pieces
from service.model.loaded_model import LoadedModel
from service.model.predictor import ROWS_AT_ONCE, Predictor
from service.model.push_cost import MAX_CONTEXTS, MAX_PUSHES, PIECE_BYTES, PIECE_S, PieceLimits, PushCost
from service.model.tensors import ContextKind, FloatArray, Gaussians, GraphSize, IndexArray
from tests.fakes import FakePredictor, draft_manifest
from tests.served_graphs import random_question, same_numbers, served_predictor

MOST_AT_ONCE = 20  # supports in one call, which take megabytes each
SIZES = [(1, 1), (5, 1), (1024, 64), (1025, 1), (1500, 65), (3000, 7), (2500, 2500), (3, 900)]  # pushes and contexts


@dataclass
class Recording:
    """A predictor that passes its calls on and notes their sizes."""

    predictor: Predictor
    calls: list[tuple[int, int]] = field(default_factory=list)

    @property
    def size(self) -> GraphSize:
        """Return the size of the graph."""
        return self.predictor.size

    def predict(
        self, rows: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``service.model.predictor.Predictor``."""
        self.calls.append((len(rows), len(contexts[0]) if contexts else 0))
        return self.predictor.predict(rows, contexts, context_index)


@pytest.fixture(scope="module")
def shipped(project_root: Path) -> dict[ContextKind, LoadedModel]:
    """Return the version that ships of each kind."""
    return {
        kind: LoadedModel(
            draft_manifest(f"push-{kind}", kind), "", served_predictor(project_root, kind), PushCost(4, 2, 1e-4)
        )
        for kind in ContextKind
    }


@pytest.mark.parametrize(("pushes", "contexts"), SIZES)
@pytest.mark.parametrize("kind", list(ContextKind))
def test_pieces_are_bounded_and_give_the_same_numbers(
    shipped: dict[ContextKind, LoadedModel], kind: ContextKind, pushes: int, contexts: int
) -> None:
    """For every model that ships each call is within the limits, and all predictions are those of one call."""
    recording = Recording(shipped[kind].predictor)
    model = replace(shipped[kind], predictor=recording)
    asked = random_question(kind, pushes, min(contexts, MOST_AT_ONCE) if kind is ContextKind.SUPPORT else contexts)

    found = predict_in_pieces(model, *asked)

    whole = recording.predictor.predict(*asked)
    for part, expected in zip(found, whole, strict=True):
        assert (part is None) == (expected is None)
        assert part is None or expected is None or same_numbers(kind, part, expected)
    limits = PieceLimits.of(model.predictor.size, model.cost)
    assert all(rows <= limits.pushes and objects <= limits.contexts for rows, objects in recording.calls)
    assert sum(rows for rows, _ in recording.calls) == pushes
    distinct = 0 if asked[2] is None else len(set(asked[2].tolist()))
    needed = max(-(-pushes // limits.pushes), -(-distinct // limits.contexts))
    assert len(recording.calls) <= 2 * needed


def limits_of(size: GraphSize, cost: PushCost) -> PieceLimits:
    """Return the limits for a graph of this size and cost."""
    return PieceLimits.of(size, cost)


@pytest.mark.parametrize(
    ("size", "cost", "expected"),
    [
        (GraphSize(), PushCost(), (MAX_PUSHES, MAX_CONTEXTS)),
        (GraphSize(PIECE_BYTES // 400, PIECE_BYTES // 10), PushCost(), (400, 10)),
        (GraphSize(PIECE_BYTES // 7, 1), PushCost(), (4, MAX_CONTEXTS)),
        (GraphSize(1 << 40, 1 << 40), PushCost(), (ROWS_AT_ONCE, 1)),
        (GraphSize(), PushCost(4, 2, PIECE_S / 10), (40, 20)),
        (GraphSize(), PushCost(4, 2, 100.0 * PIECE_S), (ROWS_AT_ONCE, 1)),
    ],
    ids=["small", "wide", "rows at once", "huge", "slow", "slower than a piece"],
)
def test_limits_follow_memory_and_time(size: GraphSize, cost: PushCost, expected: tuple[int, int]) -> None:
    """A graph of large tensors or of slow pushes gets smaller pieces, of whole groups of rows, and never empty ones."""
    assert limits_of(size, cost) == PieceLimits(*expected)


def test_a_context_is_encoded_once(shipped: dict[ContextKind, LoadedModel]) -> None:
    """Pushes are ordered by their contexts, so each context is in one piece, unless its pushes fill several."""
    recording = Recording(FakePredictor(b"", takes_context=True))
    model = replace(shipped[ContextKind.INDICATOR], predictor=recording)
    predict_in_pieces(model, *random_question(ContextKind.INDICATOR, 3000, 640))
    assert sum(objects for _, objects in recording.calls) <= 640
