"""Dense layers whose products are of 16-bit numbers, while weights and the gradients of weights stay float32.

Values are rounded for the products only, so no step of Adam is lost. A 16-bit number is negative just when its bits are
as an integer, so ReLU and its slope work on bits: torch's own widen every number to float32 and take several times as
long. Each result is overwritten on the way back, by the only one who still needs it.
"""

from collections.abc import Callable
from typing import Any, Final

import torch
from torch import Tensor


class RoundedFirst(torch.autograd.Function):
    """``ReLU(x W + b)`` of float32 poses with the weights of each object: rounded is the result alone.

    Poses and weights are sums of two 16-bit numbers each, so their products are as exact as those of float32 (but for
    the product of both remainders), and one product of a few more columns is all it takes. Poses have no gradient.
    """

    @staticmethod
    def forward(ctx: Any, pose: Tensor, weight: Tensor, bias: Tensor, dtype: torch.dtype) -> Tensor:
        """Outputs (objects, pushes, width) of poses (objects, pushes, n).

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
        """Gradients of weights and biases."""
        rows, result = ctx.saved_tensors
        found = torch.bmm(rows.transpose(1, 2), _passed(gradients[0], result)).float()
        inputs = found.shape[1] // 2
        return None, found[:, :inputs] + found[:, inputs + 1 :], found[:, inputs : inputs + 1], None


class RoundedDense(torch.autograd.Function):
    """``ReLU(x W^T + b)`` of 16-bit values."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """Outputs (n, width) of values (n, inputs)."""
        rounded = weight.to(value.dtype)
        result = torch.addmm(bias.to(value.dtype), value, rounded.T)
        _rectify(result)
        ctx.save_for_backward(value, rounded, result)
        return result

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Gradients of value, weight and bias."""
        value, rounded, result = ctx.saved_tensors
        passed = _passed(gradients[0], result)
        return passed @ rounded, (passed.T @ value).float(), passed.sum(dim=0).float()


class RoundedLast(torch.autograd.Function):
    """``x W^T + b`` of 16-bit values in float32, gradients by 16-bit products."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """Outputs (n, outputs) of values (n, inputs)."""
        ctx.save_for_backward(value, weight)
        return torch.addmm(bias, value.float(), weight.T)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Gradients of value, weight and bias."""
        value, weight = ctx.saved_tensors
        rounded = gradients[0].to(value.dtype)
        return rounded @ weight.to(value.dtype), (rounded.T @ value).float(), gradients[0].sum(dim=0)


rounded_first: Final[Callable[[Tensor, Tensor, Tensor, torch.dtype], Tensor]] = RoundedFirst.apply
rounded_dense: Final[Callable[[Tensor, Tensor, Tensor], Tensor]] = RoundedDense.apply
rounded_last: Final[Callable[[Tensor, Tensor, Tensor], Tensor]] = RoundedLast.apply


def _split(value: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """A 16-bit number and the remainder, as another."""
    large = value.to(dtype)
    return large, (value - large).to(dtype)


def _rectify(value: Tensor) -> None:
    """ReLU in place."""
    value.view(torch.int16).clamp_(min=0)


def _passed(gradient: Tensor, result: Tensor) -> Tensor:
    """The gradient before a ReLU with this result, which is overwritten."""
    mask = result.view(torch.int16).clamp_(max=1).neg_()  # all bits where the result is positive, none elsewhere
    return mask.bitwise_and_(gradient.reshape(result.shape).view(torch.int16)).view(result.dtype)
