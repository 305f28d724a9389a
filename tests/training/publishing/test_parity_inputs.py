"""Probes: objects that exist, views that could be, and the same again for the same seed."""

import numpy as np
import pytest

from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext
from training.publishing.parity_inputs import extreme_batch, feed, probe_batch


def test_probes_are_real_objects_and_repeat() -> None:
    """Random pushes of random objects that exist, indices within them, the same for the same seed."""
    batch, again, other = (probe_batch(ContextKind.INDICATOR, 40, 7, seed) for seed in (1, 1, 2))

    assert [ObjectContext.from_indicator(row.tolist()).indicator().tolist() for row in batch.context] == (
        batch.context.tolist()
    )
    assert (batch.pusher.shape, batch.context_index.min(), batch.context_index.max()) == ((40, 3), 0, 6)
    assert (batch.pusher == again.pusher).all()
    assert not (batch.pusher == other.pusher).all()


def test_probe_views_are_different_pictures_of_eight_bits() -> None:
    """Grey levels in 0..1 in steps of 1/255, no two objects alike, none of a single grey."""
    views = probe_batch(ContextKind.VISUAL, 5, 6).context

    assert views.shape == (6, 1, 32, 32)
    assert np.array_equal(np.round(views * 255.0).astype(np.uint8).astype(np.float32) / np.float32(255.0), views)
    assert len({view.tobytes() for view in views}) == 6
    assert (views.max(axis=(1, 2, 3)) > views.min(axis=(1, 2, 3))).all()


@pytest.mark.parametrize("kind", list(ContextKind))
def test_a_feed_has_what_a_graph_of_the_kind_takes(kind: ContextKind) -> None:
    """Pushes alone, or with contexts and the index of each push's object."""
    batch = extreme_batch(kind)

    assert len(feed(batch, kind)) == (1 if kind is ContextKind.NONE else 3)
    assert batch.context_index.max() < len(batch.context)
    assert (batch.context.min(), batch.context.max()) == (0.0, 1.0)
