"""Attention: layers in a row are one, dropout takes a tenth and keeps the mean, shares keep the type of products.

That a whole pass is the equations is tested with the process, in ``test_neural_process``.
"""

import pytest
import torch
from torch import nn

from training.networks.attention import Attention, Embedded, attended, dropout


def points(inputs: int, seed: int = 3) -> torch.Tensor:
    """Normal numbers for seven points of two objects."""
    return torch.randn(2, 7, inputs, generator=torch.Generator().manual_seed(seed))


def test_points_behind_a_layer_attend_as_if_they_had_gone_through_it() -> None:
    """Queries, keys and values alike; the gradient of the layer is the same too."""
    torch.manual_seed(4)
    layer, attention, valid = nn.Linear(6, 128), Attention().eval(), torch.ones(2, 7)
    found, gradients = [], []
    for given in (Embedded(points(6), layer), layer(points(6))):
        result = attention(given, given, given, valid)
        found.append(result.detach())
        gradients.append(torch.autograd.grad(result.square().mean(), [layer.weight, layer.bias]))

    assert torch.allclose(found[0], found[1], atol=1e-5)
    for one, other in zip(*gradients, strict=True):
        assert torch.allclose(one, other, atol=1e-6)


def test_what_is_not_valid_is_not_seen() -> None:
    """Whatever stands there; an object without anything valid gets numbers all the same."""
    query, key, value = torch.randn(3, 8, 5, 32, generator=torch.Generator().manual_seed(1))
    valid = torch.tensor([[1.0, 1.0, 0.0, 0.0, 0.0], [0.0] * 5])
    found = attended(query, key, value, valid)
    key[:4, 2:], value[:4, 2:] = 7.0, 9.0
    other = attended(query, key, value, valid)

    assert torch.equal(found[:4], other[:4])
    assert torch.isfinite(found).all()


def test_shares_of_16_bit_products_stay_so_under_autocast() -> None:
    """A softmax in float32 would widen the largest tensors of a step."""
    query, key, value = (torch.randn(4, 5, 32).to(torch.bfloat16).requires_grad_() for _ in range(3))
    kept: list[torch.dtype] = []

    def keep(tensor: torch.Tensor) -> torch.Tensor:
        """Note what is saved for the way back."""
        kept.append(tensor.dtype)
        return tensor

    with (
        torch.autocast("cpu", dtype=torch.bfloat16),
        torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor),
    ):
        attended(query, key, value, torch.ones(1, 5))

    assert set(kept) == {torch.bfloat16}


def test_dropout_takes_a_tenth_and_keeps_the_mean() -> None:
    """Of a million values, within four deviations of chance; any number of values, not only multiples of four."""
    torch.manual_seed(6)
    found = dropout(torch.ones(1_000_001))

    assert sorted(set(found.tolist())) == [0.0, pytest.approx(1.0 / 0.9)]
    assert (found == 0.0).float().mean().item() == pytest.approx(0.1, abs=4 * 0.0003)
    assert found.mean().item() == pytest.approx(1.0, abs=4 * 0.00034)


def test_dropout_takes_neighbours_independently() -> None:
    """The four that share one number too."""
    torch.manual_seed(7)
    gone = dropout(torch.ones(100_000, 4)) == 0.0
    for first in range(4):
        for second in range(first):
            both = (gone[:, first] & gone[:, second]).float().mean().item()
            assert both == pytest.approx(0.01, abs=4 * 0.0003), (first, second)


def test_dropout_follows_torch_s_generator() -> None:
    """So a run that is continued draws what it would have drawn."""
    drawn = []
    for _ in range(2):
        torch.manual_seed(8)
        drawn.append(dropout(torch.ones(3, 50)))

    assert torch.equal(*drawn)
    assert not torch.equal(drawn[0], dropout(torch.ones(3, 50)))


def test_only_training_drops() -> None:
    """A fitted network says the same twice."""
    torch.manual_seed(9)
    attention, valid = Attention(), torch.ones(2, 7)
    found = [attention(points(128), points(128), points(128), valid) for _ in range(2)]
    assert not torch.equal(*found)

    attention.eval()
    found = [attention(points(128), points(128), points(128), valid) for _ in range(2)]
    assert torch.equal(*found)
