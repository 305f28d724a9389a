"""Many pushes are predicted in pieces: each is bounded, and together they are the same to the bit as one call."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from service.inference.pieces import predict_in_pieces
from service.model.loaded_model import LoadedModel
from service.model.predictor import ROWS_AT_ONCE, OnnxPredictor, Predictor
from service.model.push_cost import MAX_CONTEXTS, MAX_PUSHES, PIECE_BYTES, PIECE_S, PieceLimits, PushCost
from service.model.tensors import ContextKind, FloatArray, GraphSize, IndexArray
from service.pushing.contexts import INDICATOR_LENGTH, VISUAL_SIZE
from service.registry.loading import load_version
from service.registry.registry import Registry
from tests.fakes import FakePredictor

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
        self, rows: FloatArray, context: FloatArray | None, context_index: IndexArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """See ``service.model.predictor.Predictor``."""
        self.calls.append((len(rows), 0 if context is None else len(context)))
        return self.predictor.predict(rows, context, context_index)


def question(kind: ContextKind, pushes: int, contexts: int) -> tuple[FloatArray, FloatArray | None, IndexArray | None]:
    """Return random pushes (n, 3), contexts, and an index that refers to some of the contexts in any order."""
    rng = np.random.default_rng(pushes + contexts)
    pushers = rng.uniform([-0.1, -0.1, -3.1], [0.1, 0.1, 3.1], (pushes, 3)).astype(np.float32)
    if kind is ContextKind.NONE:
        return pushers, None, None
    shape = (INDICATOR_LENGTH,) if kind is ContextKind.INDICATOR else (1, VISUAL_SIZE, VISUAL_SIZE)
    return pushers, rng.random((contexts, *shape), dtype=np.float32), rng.integers(contexts, size=pushes)


@pytest.fixture(scope="module")
def shipped(project_root: Path) -> dict[ContextKind, LoadedModel]:
    """Return a version of each kind that ships."""
    registry = Registry(project_root / "models")
    names = {kind: f"push-{kind}" for kind in ContextKind}
    return {
        kind: replace(
            load_version(registry, OnnxPredictor, name, registry.versions(name)[-1]), cost=PushCost(4, 2, 1e-4)
        )
        for kind, name in names.items()
    }


@pytest.mark.parametrize(("pushes", "contexts"), SIZES)
@pytest.mark.parametrize("kind", list(ContextKind))
def test_pieces_are_bounded_and_give_the_same_bits(
    shipped: dict[ContextKind, LoadedModel], kind: ContextKind, pushes: int, contexts: int
) -> None:
    """For every model that ships each call is within the limits, and all predictions are those of one call."""
    recording = Recording(shipped[kind].predictor)
    model = replace(shipped[kind], predictor=recording)
    asked = question(kind, pushes, contexts)

    found = predict_in_pieces(model, *asked)

    whole = recording.predictor.predict(*asked)
    assert [part.tobytes() for part in found] == [part.tobytes() for part in whole]
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
    predict_in_pieces(model, *question(ContextKind.INDICATOR, 3000, 640))
    assert sum(objects for _, objects in recording.calls) <= 640
