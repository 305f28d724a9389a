"""The proof that a model is what was published, and still answers."""

from dataclasses import replace

import pytest

from service.errors import BrokenModelError
from service.model.self_check import check_itself
from service.model.tensors import ContextKind
from tests.fakes import LYING, FakePredictor, draft_manifest


@pytest.mark.parametrize("kind", list(ContextKind))
def test_a_model_that_answers_as_it_did_passes(kind: ContextKind) -> None:
    """Of every kind: the stored row becomes a view for those that see."""
    check_itself(draft_manifest("push", kind), FakePredictor(b"", kind is not ContextKind.NONE))


def test_a_model_that_answers_otherwise_does_not() -> None:
    """By more than the tolerance that was stored."""
    with pytest.raises(BrokenModelError, match=r"differs by more than 0\.0001"):
        check_itself(draft_manifest(), FakePredictor(LYING, takes_context=True))


def test_a_stored_input_that_cannot_be_run_is_a_broken_model() -> None:
    """Rows of different lengths, as hands would leave them."""
    manifest = draft_manifest()
    ragged = replace(manifest.self_check, pusher=[[0.0], [0.0, 1.0]])
    with pytest.raises(BrokenModelError, match="cannot be run"):
        check_itself(replace(manifest, self_check=ragged), FakePredictor(b"", takes_context=True))
