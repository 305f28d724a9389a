"""The visual encoder as a layer of its own: its batch norm, in training and fitted."""

import torch

from training.networks.encoders import VisualEncoder


def test_repeated_contexts_have_the_same_encoding() -> None:
    """Encoding each object once gives the values of encoding a copy per push, as the published loop does."""
    torch.manual_seed(4)
    encoder, views = VisualEncoder(256), torch.rand(6, 1, 32, 32)
    with torch.no_grad():
        once = encoder(views)
        repeated = encoder(views.repeat_interleave(5, dim=0))

    torch.testing.assert_close(repeated, once.repeat_interleave(5, dim=0), atol=1e-5, rtol=1e-4)


def test_a_fitted_encoder_sees_each_view_alone() -> None:
    """The encoding of a view by a fitted encoder does not depend on the other views of the batch."""
    torch.manual_seed(4)
    encoder, views = VisualEncoder(256), torch.rand(6, 1, 32, 32)
    encoder(views)
    encoder.eval()

    torch.testing.assert_close(encoder(views[2:3]), encoder(views)[2:3], atol=1e-6, rtol=1e-5)
