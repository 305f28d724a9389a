"""Mixed precision: dense layers with 16-bit products have the values and gradients of exact ones, up to rounding."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from training.networks.mixed_precision import mixed_dense, mixed_first, mixed_last

ROUNDED = torch.bfloat16


def exact_and_mixed(
    exact: Callable[..., Tensor], mixed: Callable[..., Tensor], *values: Tensor
) -> tuple[list[Tensor], list[Tensor]]:
    """Return the results of both layers, and the gradients of all but the first value, for the same gradient above."""
    found = []
    for layer in (exact, mixed):
        given = [values[0], *(value.clone().requires_grad_() for value in values[1:])]
        result = layer(*given)
        kept = result.detach().clone()  # the backward pass overwrites a mixed result
        above = torch.randn(result.shape, generator=torch.Generator().manual_seed(0))
        torch.autograd.backward((result.float() * above).sum())
        found.append([kept, *(value.grad for value in given[1:] if value.grad is not None)])
    return found[0], found[1]


def assert_near(found: list[Tensor], expected: list[Tensor], share: float) -> None:
    """Check that each result is within this share of the norm of the expected one, with float32 gradients."""
    assert len(found) == len(expected)
    for mine, theirs in zip(found, expected, strict=True):
        assert (mine.float() - theirs).norm() <= share * theirs.norm()
    assert {gradient.dtype for gradient in found[1:]} == {torch.float32}


def test_a_dense_layer_has_the_values_and_slopes_of_the_exact_one() -> None:
    """A mixed dense layer differs from the exact one by at most 5 %, mostly where ReLU gates flip."""
    torch.manual_seed(7)
    value, weight, bias = torch.randn(120, 256).to(ROUNDED).float(), torch.randn(256, 256) / 16.0, torch.randn(256)
    exact, mixed = exact_and_mixed(
        lambda shift, w, b: torch.relu((value + shift) @ w.T + b),
        lambda shift, w, b: mixed_dense((value + shift).to(ROUNDED), w, b),
        torch.zeros(()),
        weight,
        bias,
    )

    assert mixed[0].dtype is ROUNDED
    assert_near(mixed, exact, 0.05)


def test_two_dense_layers_pass_the_gradient_of_their_values() -> None:
    """The gradient passes through two layers, whose results are overwritten on the way, to the values below."""
    torch.manual_seed(8)
    value, weight, bias = torch.randn(60, 256), torch.randn(256, 256) / 16.0, torch.randn(256)
    exact, mixed = exact_and_mixed(
        lambda _, x: torch.relu(torch.relu(x @ weight.T + bias) @ weight.T + bias),
        lambda _, x: mixed_dense(mixed_dense(x.to(ROUNDED), weight, bias), weight, bias),
        torch.zeros(()),
        value,
    )

    assert_near(mixed, exact, 0.08)


def test_the_first_layer_rounds_its_result_alone() -> None:
    """The first layer rounds its result only: poses and weights finer than 16 bits give the exact values."""
    torch.manual_seed(9)
    pose, weight, bias = torch.randn(3, 40, 4), torch.randn(3, 4, 256), torch.randn(3, 1, 256)
    exact, mixed = exact_and_mixed(
        lambda x, w, b: torch.relu(x @ w + b), lambda x, w, b: mixed_first(x, w, b, ROUNDED), pose, weight, bias
    )

    step = torch.finfo(ROUNDED).eps
    assert ((mixed[0].float() - exact[0]).abs() <= 0.51 * step * exact[0] + 1e-4).all()
    assert_near(mixed, exact, 0.01)


def test_the_last_layer_gives_float32() -> None:
    """The last layer's values are as exact as its inputs, and its gradients come from 16-bit products."""
    torch.manual_seed(10)
    value, weight, bias = torch.randn(90, 256).to(ROUNDED).float(), torch.randn(6, 256), torch.randn(6)
    exact, mixed = exact_and_mixed(
        lambda shift, w, b: (value + shift) @ w.T + b,
        lambda shift, w, b: mixed_last((value + shift).to(ROUNDED), w, b),
        torch.zeros(()),
        weight,
        bias,
    )

    assert mixed[0].dtype is torch.float32
    torch.testing.assert_close(mixed[0], exact[0])
    assert_near(mixed, exact, 0.01)


def test_a_second_backward_pass_is_refused() -> None:
    """A second backward pass is refused, because the first has overwritten the results that it needs."""
    value, weight, bias = torch.randn(5, 8), torch.randn(4, 8, requires_grad=True), torch.randn(4)
    total = mixed_dense(value.to(ROUNDED), weight, bias).float().sum()
    torch.autograd.backward(total, retain_graph=True)

    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        torch.autograd.backward(total)


def test_a_layer_without_positive_outputs_has_no_gradient() -> None:
    """Outputs of zero, even of negative zero, pass no gradient."""
    value = torch.zeros(5, 8, dtype=torch.bfloat16, requires_grad=True)
    weight, bias = torch.ones(4, 8), -torch.zeros(4)
    result = mixed_dense(value, weight, bias)
    assert result.detach().eq(0.0).all()
    torch.autograd.backward(result.float().sum())

    assert value.grad is not None
    assert value.grad.eq(0.0).all()
