"""Parity inputs: objects that can exist, plausible views, and the same batch for the same seed."""

import numpy as np
import pytest

from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext
from service.pushing.onnx_interface import expected_inputs
from training.publishing.parity_inputs import extreme_batch, graph_inputs, plausible_batch


def test_plausible_batches_have_valid_objects_and_repeat() -> None:
    """A plausible batch has objects that can exist and valid indices, and repeats for the same seed."""
    batch, again, other = (plausible_batch(ContextKind.INDICATOR, 40, 7, seed) for seed in (1, 1, 2))

    assert [ObjectContext.from_indicator(row.tolist()).indicator().tolist() for row in batch.contexts[0]] == (
        batch.contexts[0].tolist()
    )
    assert (batch.pusher.shape, batch.context_index.min(), batch.context_index.max()) == ((40, 3), 0, 6)
    assert (batch.pusher == again.pusher).all()
    assert not (batch.pusher == other.pusher).all()


def test_plausible_views_are_different_8_bit_images() -> None:
    """Plausible views have grey levels in steps of 1/255, no two views are alike, and none is of a single grey."""
    (views,) = plausible_batch(ContextKind.VISUAL, 5, 6).contexts

    assert views.shape == (6, 1, 32, 32)
    assert np.array_equal(np.round(views * 255.0).astype(np.uint8).astype(np.float32) / np.float32(255.0), views)
    assert len({view.tobytes() for view in views}) == 6
    assert (views.max(axis=(1, 2, 3)) > views.min(axis=(1, 2, 3))).all()


@pytest.mark.parametrize("kind", list(ContextKind))
def test_graph_inputs_are_those_of_the_kind(kind: ContextKind) -> None:
    """The inputs of a graph are pushes alone, or pushes with contexts and the context index of each push."""
    batch = extreme_batch(kind)

    arrays = graph_inputs(batch, kind)
    assert [(array.dtype.name, array.shape[1:]) for array in arrays] == [
        (tensor.dtype, tensor.shape[1:]) for tensor in expected_inputs(kind)
    ]
    if batch.contexts:
        assert batch.context_index.max() < len(batch.contexts[0])
    if kind in (ContextKind.INDICATOR, ContextKind.VISUAL):
        assert (batch.contexts[0].min(), batch.contexts[0].max()) == (0.0, 1.0)
