"""The seam around onnxruntime, on the model that ships."""

from pathlib import Path

import numpy as np
import pytest

from service.contract import ContextKind, ObjectContext
from service.errors import BrokenModelError, PredictionError
from service.manifest import ModelReference
from service.predictor import OnnxPredictor, Predictor
from service.registry import Registry


@pytest.fixture(scope="module")
def shipped(project_root: Path) -> bytes:
    """The graph of the champion."""
    registry = Registry(project_root / "models")
    return registry.read("push-indicator", registry.resolve(ModelReference.parse("push-indicator"))).model


@pytest.fixture(scope="module")
def predictor(shipped: bytes) -> Predictor:
    """The champion, loaded."""
    return OnnxPredictor(shipped, ContextKind.INDICATOR)


def pushes(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random pushes of three objects."""
    rng = np.random.default_rng(0)
    pusher = rng.uniform(-0.08, 0.08, (count, 3)).astype(np.float32)
    context = np.stack(
        [ObjectContext.from_descriptor(name).indicator() for name in ("1a2b3c4a", "4a4a4a4a", "3c3a2B1a")]
    )
    return pusher, context, rng.integers(3, size=count)


def test_a_batch_gives_a_mean_and_a_positive_std_per_push(predictor: Predictor) -> None:
    """One row out per row in, float32, in SI units."""
    mean, std = predictor.predict(*pushes(7))
    assert mean.shape == std.shape == (7, 3)
    assert mean.dtype == std.dtype == np.float32
    assert (std > 0).all()


def test_a_row_does_not_depend_on_the_rows_beside_it(predictor: Predictor) -> None:
    """A mixed batch gives what its pushes give one by one, within float32 rounding."""
    pusher, context, index = pushes(20)
    together = predictor.predict(pusher, context, index)
    for row in range(len(pusher)):
        alone = predictor.predict(pusher[row : row + 1], context[index[row]][None], np.zeros(1, dtype=np.int64))
        np.testing.assert_allclose(alone[0][0], together[0][row], atol=1e-6)
        np.testing.assert_allclose(alone[1][0], together[1][row], atol=1e-6)


@pytest.mark.parametrize("model", [b"", b"not a model", b"\x08\x0a" * 50], ids=["empty", "text", "noise"])
def test_bytes_that_are_no_graph_are_a_broken_model(model: bytes) -> None:
    """The runtime's own errors do not leave this module."""
    with pytest.raises(BrokenModelError, match=r"model\.onnx: (not an ONNX model|onnxruntime refuses)"):
        OnnxPredictor(model, ContextKind.INDICATOR)


def test_a_graph_with_other_tensors_is_a_broken_model(shipped: bytes) -> None:
    """A graph that wants a context is none for models without."""
    with pytest.raises(BrokenModelError, match="not those of the contract"):
        OnnxPredictor(shipped, ContextKind.NONE)


def test_an_index_beyond_the_contexts_is_a_prediction_error(predictor: Predictor) -> None:
    """The runtime's refusal is translated."""
    pusher, context, index = pushes(2)
    with pytest.raises(PredictionError, match="could not evaluate"):
        predictor.predict(pusher, context, index + 3)


def test_an_answer_that_is_no_gaussian_never_leaves(predictor: Predictor) -> None:
    """A mean that overflows is an error, not an answer."""
    pusher, context, index = pushes(1)
    with pytest.raises(PredictionError, match="not finite"):
        predictor.predict(np.full_like(pusher, np.float32(3e38)), context, index)
