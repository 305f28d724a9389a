"""Multi-head attention of the neural process, at the least cost that gives the same numbers.

Two things are done otherwise than in the equations, which they leave as they are: a dense layer behind a dense layer is
one with the product of their weights, so that a push of six numbers never becomes 128 on its way to a query; and shares
stay in the type of the products that they come from and go to.
"""

import math
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTH: Final = 128
HEADS: Final = 4
DROPOUT: Final = 0.1
_HEAD_WIDTH: Final = WIDTH // HEADS
_BITS: Final = 16  # of chance for each value that dropout may take


@dataclass(frozen=True)
class Embedded:
    """Points (objects, n, inputs) on whose way to a width of 128 stands a dense layer."""

    points: Tensor
    layer: nn.Linear

    def embedded(self) -> Tensor:
        """Behind the layer, (objects, n, 128)."""
        result: Tensor = self.layer(self.points)
        return result

    def through(self, layer: nn.Linear) -> Tensor:
        """Behind another layer as well."""
        return functional.linear(
            self.points, layer.weight @ self.layer.weight, layer.weight @ self.layer.bias + layer.bias
        )


class Attention(nn.Module):
    """Multi-head attention, then dropout, the sum with the queries, and layer norm."""

    def __init__(self) -> None:
        super().__init__()
        self.query, self.key, self.value, self.mixture = (nn.Linear(WIDTH, WIDTH) for _ in range(4))
        self.norm = nn.LayerNorm(WIDTH)

    def forward(
        self, queries: Tensor | Embedded, keys: Tensor | Embedded, values: Tensor | Embedded, valid: Tensor
    ) -> Tensor:
        """Attend from (objects, n, 128) to those of (objects, m, 128) that are valid (objects, m)."""
        query, key, value = (
            _heads(given.through(layer) if isinstance(given, Embedded) else layer(given))
            for layer, given in ((self.query, queries), (self.key, keys), (self.value, values))
        )
        together = self.mixture(_together(attended(query / math.sqrt(_HEAD_WIDTH), key, value, valid)))
        before = queries.embedded() if isinstance(queries, Embedded) else queries
        result: Tensor = self.norm(before + (dropout(together) if self.training else together))
        return result


def attended(query: Tensor, key: Tensor, value: Tensor, valid: Tensor) -> Tensor:
    """Values of each query (objects * 4, n, 32), by its likeness to the keys that are valid (objects, m).

    On a processor, torch's fused attention takes several times as long to go back.
    """
    # an object without a single key attends to padding: the result is never used, but it must not be NaN
    seen = (valid > 0) | (valid.sum(dim=1, keepdim=True) == 0)
    unseen = torch.zeros_like(valid, dtype=query.dtype).masked_fill(~seen, -torch.inf)
    unseen = unseen.repeat_interleave(HEADS, dim=0)[:, None, :].expand(-1, query.shape[1], -1)
    with torch.autocast(query.device.type, enabled=False):  # it would have shares in float32, for 16-bit products
        result: Tensor = torch.softmax(torch.baddbmm(unseen, query, key.transpose(1, 2)), dim=-1) @ value
        return result


def dropout(value: Tensor) -> Tensor:
    """Nothing for a tenth of the values, and more of the others.

    Torch draws a number for each; here four share one of 64 bits, which is four times as fast.
    """
    values = value.numel()
    bits = torch.empty(-(-values * _BITS // 64), dtype=torch.int64, device=value.device).random_(-(2**63), None)
    chance = bits.view(torch.int16)[:values].view(value.shape)
    least = round(DROPOUT * 2**_BITS) - 2 ** (_BITS - 1)
    kept: Tensor = (chance >= least).to(value.dtype)
    return value * (kept / (1.0 - DROPOUT))


def _heads(value: Tensor) -> Tensor:
    """(objects, n, 128) as (objects * 4, n, 32)."""
    return value.view(*value.shape[:2], HEADS, _HEAD_WIDTH).transpose(1, 2).flatten(0, 1)


def _together(value: Tensor) -> Tensor:
    """(objects * 4, n, 32) as (objects, n, 128)."""
    return value.view(-1, HEADS, *value.shape[1:]).transpose(1, 2).flatten(2)
