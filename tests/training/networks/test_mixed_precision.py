"""Layers of 16-bit products: values and slopes of the exact ones, to the rounding."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from training.networks.mixed_precision import rounded_dense, rounded_first, rounded_last

ROUNDED = torch.bfloat16


def exact_and_rounded(
    exact: Callable[..., Tensor], rounded: Callable[..., Tensor], *values: Tensor
) -> tuple[list[Tensor], list[Tensor]]:
    """The results of both and the gradients of all but the first value, for the same slope above."""
    found = []
    for layer in (exact, rounded):
        given = [values[0], *(value.clone().requires_grad_() for value in values[1:])]
        result = layer(*given)
        kept = result.detach().clone()  # a rounded one is overwritten on the way back
        above = torch.randn(result.shape, generator=torch.Generator().manual_seed(0))
        torch.autograd.backward((result.float() * above).sum())
        found.append([kept, *(value.grad for value in given[1:] if value.grad is not None)])
    return found[0], found[1]


def assert_near(found: list[Tensor], expected: list[Tensor], share: float) -> None:
    """Each within this share of the length of what is expected, gradients in float32."""
    assert len(found) == len(expected)
    for mine, theirs in zip(found, expected, strict=True):
        assert (mine.float() - theirs).norm() <= share * theirs.norm()
    assert {gradient.dtype for gradient in found[1:]} == {torch.float32}


def test_a_dense_layer_has_the_values_and_slopes_of_the_exact_one() -> None:
    """``ReLU(x W^T + b)``; what is left in the slopes is mostly gates that flip."""
    torch.manual_seed(7)
    value, weight, bias = torch.randn(120, 256).to(ROUNDED).float(), torch.randn(256, 256) / 16.0, torch.randn(256)
    exact, rounded = exact_and_rounded(
        lambda shift, w, b: torch.relu((value + shift) @ w.T + b),
        lambda shift, w, b: rounded_dense((value + shift).to(ROUNDED), w, b),
        torch.zeros(()),
        weight,
        bias,
    )

    assert rounded[0].dtype is ROUNDED
    assert_near(rounded, exact, 0.05)


def test_a_dense_layer_hands_the_slope_of_its_values_down() -> None:
    """The gradient goes through two layers, whose results are overwritten on the way, to the values below."""
    torch.manual_seed(8)
    value, weight, bias = torch.randn(60, 256), torch.randn(256, 256) / 16.0, torch.randn(256)
    exact, rounded = exact_and_rounded(
        lambda _, x: torch.relu(torch.relu(x @ weight.T + bias) @ weight.T + bias),
        lambda _, x: rounded_dense(rounded_dense(x.to(ROUNDED), weight, bias), weight, bias),
        torch.zeros(()),
        value,
    )

    assert_near(rounded, exact, 0.08)


def test_the_first_layer_rounds_its_result_alone() -> None:
    """Poses and weights far finer than 16 bits tell give the exact values, and each object has its own slopes."""
    torch.manual_seed(9)
    pose, weight, bias = torch.randn(3, 40, 4), torch.randn(3, 4, 256), torch.randn(3, 1, 256)
    exact, rounded = exact_and_rounded(
        lambda x, w, b: torch.relu(x @ w + b), lambda x, w, b: rounded_first(x, w, b, ROUNDED), pose, weight, bias
    )

    step = torch.finfo(ROUNDED).eps
    assert ((rounded[0].float() - exact[0]).abs() <= 0.51 * step * exact[0] + 1e-4).all()
    assert_near(rounded, exact, 0.01)


def test_the_last_layer_gives_float32() -> None:
    """Values as exact as those that go in; slopes by 16-bit products."""
    torch.manual_seed(10)
    value, weight, bias = torch.randn(90, 256).to(ROUNDED).float(), torch.randn(6, 256), torch.randn(6)
    exact, rounded = exact_and_rounded(
        lambda shift, w, b: (value + shift) @ w.T + b,
        lambda shift, w, b: rounded_last((value + shift).to(ROUNDED), w, b),
        torch.zeros(()),
        weight,
        bias,
    )

    assert rounded[0].dtype is torch.float32
    torch.testing.assert_close(rounded[0], exact[0])
    assert_near(rounded, exact, 0.01)


def test_a_second_way_back_is_refused() -> None:
    """The results that it would need are overwritten."""
    value, weight, bias = torch.randn(5, 8), torch.randn(4, 8, requires_grad=True), torch.randn(4)
    total = rounded_dense(value.to(ROUNDED), weight, bias).float().sum()
    torch.autograd.backward(total, retain_graph=True)

    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        torch.autograd.backward(total)


def test_a_layer_that_is_nowhere_positive_has_no_slope() -> None:
    """Not even negative zeros let anything through."""
    value = torch.zeros(5, 8, dtype=torch.bfloat16, requires_grad=True)
    weight, bias = torch.ones(4, 8), -torch.zeros(4)
    result = rounded_dense(value, weight, bias)
    assert result.detach().eq(0.0).all()
    torch.autograd.backward(result.float().sum())

    assert value.grad is not None
    assert value.grad.eq(0.0).all()
