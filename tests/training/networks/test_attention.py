"""Attention: fused layers, padding, dropout, and the type of attention weights.

``test_neural_process`` compares a whole forward pass with the equations.
"""

import pytest
import torch
from torch import nn

from training.networks.attention import Attention, Embedded, attend, dropout


def points(inputs: int, seed: int = 3) -> torch.Tensor:
    """Draw normal numbers for seven points of two objects."""
    return torch.randn(2, 7, inputs, generator=torch.Generator().manual_seed(seed))


def test_embedded_points_attend_like_the_layer_s_outputs() -> None:
    """Embedded queries, keys and values give the outputs and gradients of points that went through the layer."""
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


def test_a_memory_is_shared_by_the_queries_of_its_object() -> None:
    """Queries one by one, each with the memory of its object, get what they get together."""
    torch.manual_seed(4)
    attention, valid = Attention().eval(), torch.tensor([[1.0] * 7, [1.0] * 3 + [0.0] * 4])
    keys, queries = points(128), points(128, seed=5)
    together = attention(queries, keys, keys, valid)
    index = torch.tensor([1, 0, 1])
    alone = attention.answer(queries[index, 2:3], attention.memory(keys, keys).of(index), valid[index])

    assert torch.allclose(alone[:, 0], together[index, 2], atol=1e-5)


def test_padding_is_not_attended_to() -> None:
    """Attention ignores values in padding, and an object without a valid point gets finite numbers."""
    query, key, value = torch.randn(3, 8, 5, 32, generator=torch.Generator().manual_seed(1))
    valid = torch.tensor([[1.0, 1.0, 0.0, 0.0, 0.0], [0.0] * 5])
    found = attend(query, key, value, valid)
    key[:4, 2:], value[:4, 2:] = 7.0, 9.0
    other = attend(query, key, value, valid)

    assert torch.equal(found[:4], other[:4])
    assert torch.isfinite(found).all()


def test_attention_weights_stay_16_bit_under_autocast() -> None:
    """Attention saves bfloat16 tensors only: a softmax in float32 would widen the largest tensors of a step."""
    query, key, value = (torch.randn(4, 5, 32).to(torch.bfloat16).requires_grad_() for _ in range(3))
    kept: list[torch.dtype] = []

    def keep(tensor: torch.Tensor) -> torch.Tensor:
        """Record the type of a tensor that is saved for the backward pass."""
        kept.append(tensor.dtype)
        return tensor

    with (
        torch.autocast("cpu", dtype=torch.bfloat16),
        torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor),
    ):
        attend(query, key, value, torch.ones(1, 5))

    assert set(kept) == {torch.bfloat16}


def test_dropout_takes_a_tenth_and_keeps_the_mean() -> None:
    """Dropout drops a tenth of any number of values and keeps their mean, within four deviations of chance."""
    torch.manual_seed(6)
    found = dropout(torch.ones(1_000_001))

    assert sorted(set(found.tolist())) == [0.0, pytest.approx(1.0 / 0.9)]
    assert (found == 0.0).float().mean().item() == pytest.approx(0.1, abs=4 * 0.0003)
    assert found.mean().item() == pytest.approx(1.0, abs=4 * 0.00034)


def test_dropout_takes_neighbours_independently() -> None:
    """Dropout drops neighbours independently, even four that share one random number."""
    torch.manual_seed(7)
    gone = dropout(torch.ones(100_000, 4)) == 0.0
    for first in range(4):
        for second in range(first):
            both = (gone[:, first] & gone[:, second]).float().mean().item()
            assert both == pytest.approx(0.01, abs=4 * 0.0003), (first, second)


def test_dropout_follows_torch_s_generator() -> None:
    """Dropout repeats with the seed of torch's generator, so that a continued run draws the same numbers."""
    drawn = []
    for _ in range(2):
        torch.manual_seed(8)
        drawn.append(dropout(torch.ones(3, 50)))

    assert torch.equal(*drawn)
    assert not torch.equal(drawn[0], dropout(torch.ones(3, 50)))


def test_dropout_runs_in_training_only() -> None:
    """A fitted network gives the same output twice, and a network in training does not."""
    torch.manual_seed(9)
    attention, valid = Attention(), torch.ones(2, 7)
    found = [attention(points(128), points(128), points(128), valid) for _ in range(2)]
    assert not torch.equal(*found)

    attention.eval()
    found = [attention(points(128), points(128), points(128), valid) for _ in range(2)]
    assert torch.equal(*found)
