"""The visual encoder as a layer of its own: batch norm that does not care how often a context is repeated."""

import torch

from training.networks.encoders import VisualEncoder


def test_repeating_contexts_changes_nothing() -> None:
    """The published loop encodes a copy per push; encoding each object once gives the same values in training."""
    torch.manual_seed(4)
    encoder, views = VisualEncoder(256), torch.rand(6, 1, 32, 32)
    with torch.no_grad():
        once = encoder(views)
        repeated = encoder(views.repeat_interleave(5, dim=0))

    torch.testing.assert_close(repeated, once.repeat_interleave(5, dim=0), atol=1e-5, rtol=1e-4)


def test_a_fitted_encoder_sees_each_view_alone() -> None:
    """Served, the answer for an object does not depend on who else is asked about."""
    torch.manual_seed(4)
    encoder, views = VisualEncoder(256), torch.rand(6, 1, 32, 32)
    encoder(views)
    encoder.eval()

    torch.testing.assert_close(encoder(views[2:3]), encoder(views)[2:3], atol=1e-6, rtol=1e-5)
