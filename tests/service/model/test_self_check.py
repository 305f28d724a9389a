"""Self-check: a loaded version must still predict its stored output."""

from dataclasses import replace

import pytest

from service.errors import BrokenModelError
from service.model.self_check import MAX_BYTES, check_itself
from service.model.tensors import ContextKind, GraphSize
from tests.fakes import LYING, FakePredictor, draft_manifest


@pytest.mark.parametrize("kind", list(ContextKind))
def test_a_model_that_predicts_its_stored_output_passes(kind: ContextKind) -> None:
    """A model of every kind passes with the output that was stored. A visual context is stored as one row."""
    check_itself(draft_manifest("push", kind), FakePredictor(b"", kind is not ContextKind.NONE))


def test_a_model_that_differs_by_more_than_the_tolerance_is_broken() -> None:
    """A model whose output differs by more than the stored tolerance is broken."""
    with pytest.raises(BrokenModelError, match=r"differs by more than 0\.0001"):
        check_itself(draft_manifest(), FakePredictor(LYING, takes_context=True))


def test_a_stored_input_that_cannot_be_run_is_a_broken_model() -> None:
    """A stored input with rows of different lengths makes the version broken."""
    manifest = draft_manifest()
    ragged = replace(manifest.self_check, pusher=[[0.0], [0.0, 1.0]])
    with pytest.raises(BrokenModelError, match="cannot be run"):
        check_itself(replace(manifest, self_check=ragged), FakePredictor(b"", takes_context=True))


def test_a_self_check_that_takes_much_memory_is_a_broken_model() -> None:
    """Stored rows are bounded by the size of the graph: a large graph may store few of them."""
    predictor = FakePredictor(b"", takes_context=True)
    predictor.size = GraphSize(row_bytes=MAX_BYTES, context_bytes=1)
    with pytest.raises(BrokenModelError, match="store fewer rows"):
        check_itself(draft_manifest(), predictor)
