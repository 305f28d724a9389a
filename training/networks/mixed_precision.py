"""Mixed precision: dense layers with 16-bit products, while weights and their gradients stay float32.

Values are rounded for the products only, so no step of Adam is lost. A 16-bit float is negative exactly when its bits
are negative as an integer. ReLU and its slope therefore work on bits: torch's own versions widen every number to
float32 and take several times as long. The backward pass overwrites each result, because it is its last reader.
"""

from collections.abc import Callable
from typing import Any, Final

import torch
from torch import Tensor


class MixedFirst(torch.autograd.Function):
    """First layer ``ReLU(x W + b)`` of float32 poses with the weights of each object. Only the result is rounded.

    Poses and weights are written as sums of two 16-bit numbers each. Their products are then as exact as in float32,
    except for the product of both remainders, and a single product with a few more columns computes them. Poses have
    no gradient.
    """

    @staticmethod
    def forward(ctx: Any, pose: Tensor, weight: Tensor, bias: Tensor, dtype: torch.dtype) -> Tensor:
        """Compute outputs (objects, pushes, width) of poses (objects, pushes, n).

        Weights are (objects, n, width), biases (objects, 1, width).
        """
        one = pose.new_ones(*pose.shape[:-1], 1)
        large, small = _split(torch.cat([pose, one], dim=-1), dtype)
        above, below = _split(torch.cat([weight, bias], dim=1), dtype)
        rows = torch.cat([large, small[..., :-1], large], dim=-1)
        result = torch.bmm(rows, torch.cat([above, above[:, :-1], below], dim=1))
        _rectify(result)
        ctx.save_for_backward(rows[..., : 2 * pose.shape[-1] + 1], result)
        return result

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, Tensor, Tensor, None]:
        """Compute the gradients of weights and biases."""
        rows, result = ctx.saved_tensors
        found = torch.bmm(rows.transpose(1, 2), _rectified_gradient(gradients[0], result)).float()
        inputs = found.shape[1] // 2
        return None, found[:, :inputs] + found[:, inputs + 1 :], found[:, inputs : inputs + 1], None


class MixedDense(torch.autograd.Function):
    """Dense layer ``ReLU(x W^T + b)`` of 16-bit values."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """Compute outputs (n, width) of values (n, inputs)."""
        rounded = weight.to(value.dtype)
        result = torch.addmm(bias.to(value.dtype), value, rounded.T)
        _rectify(result)
        ctx.save_for_backward(value, rounded, result)
        return result

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Compute the gradients of value, weight and bias."""
        value, rounded, result = ctx.saved_tensors
        gradient = _rectified_gradient(gradients[0], result)
        return gradient @ rounded, (gradient.T @ value).float(), gradient.sum(dim=0).float()


class MixedLast(torch.autograd.Function):
    """Last layer ``x W^T + b`` of 16-bit values in float32, with gradients by 16-bit products."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """Compute outputs (n, outputs) of values (n, inputs)."""
        ctx.save_for_backward(value, weight)
        return torch.addmm(bias, value.float(), weight.T)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Compute the gradients of value, weight and bias."""
        value, weight = ctx.saved_tensors
        rounded = gradients[0].to(value.dtype)
        return rounded @ weight.to(value.dtype), (rounded.T @ value).float(), gradients[0].sum(dim=0)


mixed_first: Final[Callable[[Tensor, Tensor, Tensor, torch.dtype], Tensor]] = MixedFirst.apply
mixed_dense: Final[Callable[[Tensor, Tensor, Tensor], Tensor]] = MixedDense.apply
mixed_last: Final[Callable[[Tensor, Tensor, Tensor], Tensor]] = MixedLast.apply


def _split(value: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Split float32 numbers into a 16-bit number and the remainder, as another one."""
    large = value.to(dtype)
    return large, (value - large).to(dtype)


def _rectify(value: Tensor) -> None:
    """Apply ReLU in place."""
    value.view(torch.int16).clamp_(min=0)


def _rectified_gradient(gradient: Tensor, result: Tensor) -> Tensor:
    """Return the gradient before a ReLU with this result, which is overwritten."""
    mask = result.view(torch.int16).clamp_(max=1).neg_()  # all bits set where the result is positive
    return mask.bitwise_and_(gradient.reshape(result.shape).view(torch.int16)).view(result.dtype)
