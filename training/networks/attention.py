"""Multi-head attention of the neural process, written for speed, with the numbers of the plain equations.

Two things differ from the plain way of writing it. Two dense layers in a row are one layer with the product of their
weights, so a push of six numbers is never widened to 128 on its way to a query. Attention weights keep the type of the
products that they come from and go to.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTH: Final = 128
HEADS: Final = 4
DROPOUT: Final = 0.1
_HEAD_WIDTH: Final = WIDTH // HEADS
_BITS: Final = 16  # random bits for each value that dropout may drop


@dataclass(frozen=True)
class Embedded:
    """Points (objects, n, inputs) together with the dense layer that embeds them in a width of 128."""

    points: Tensor
    layer: nn.Linear

    def embed(self) -> Tensor:
        """Apply the layer: (objects, n, 128)."""
        result: Tensor = self.layer(self.points)
        return result

    def embed_through(self, following: nn.Linear) -> Tensor:
        """Apply the layer and a following one, by the product of their weights."""
        weight, bias = self.layer.weight, self.layer.bias
        return functional.linear(self.points, following.weight @ weight, following.weight @ bias + following.bias)


class Memory(NamedTuple):
    """Keys and values of an attention, by head: (objects, 4, m, 32) each."""

    key: Tensor
    value: Tensor

    def of(self, index: Tensor) -> "Memory":
        """Return the memories of some objects (n,), in this order."""
        return Memory(torch.index_select(self.key, 0, index), torch.index_select(self.value, 0, index))


class Attention(nn.Module):
    """Multi-head attention, then dropout, the sum with the queries, and layer norm."""

    def __init__(self) -> None:
        super().__init__()
        self.query, self.key, self.value, self.mixture = (nn.Linear(WIDTH, WIDTH) for _ in range(4))
        self.norm = nn.LayerNorm(WIDTH)

    def forward(
        self, queries: Tensor | Embedded, keys: Tensor | Embedded, values: Tensor | Embedded, valid: Tensor
    ) -> Tensor:
        """Attend from queries (objects, n, 128) to keys and values (objects, m, 128) where valid (objects, m)."""
        return self.answer(queries, self.memory(keys, values), valid)

    def memory(self, keys: Tensor | Embedded, values: Tensor | Embedded) -> Memory:
        """Compute the part that does not depend on queries."""
        return Memory(_split_heads(_through(keys, self.key)), _split_heads(_through(values, self.value)))

    def answer(self, queries: Tensor | Embedded, memory: Memory, valid: Tensor) -> Tensor:
        """Attend from queries (objects, n, 128) to a memory where valid (objects, m)."""
        query = _split_heads(_through(queries, self.query)).flatten(0, 1) / math.sqrt(_HEAD_WIDTH)
        attended = self.mixture(
            _merge_heads(attend(query, memory.key.flatten(0, 1), memory.value.flatten(0, 1), valid))
        )
        residual = queries.embed() if isinstance(queries, Embedded) else queries
        result: Tensor = self.norm(residual + (dropout(attended) if self.training else attended))
        return result


def attend(query: Tensor, key: Tensor, value: Tensor, valid: Tensor) -> Tensor:
    """Average the values for each query (objects * 4, n, 32), by its similarity to the valid (objects, m) keys.

    On a CPU, the backward pass of torch's fused attention takes several times as long.
    """
    # An object without a valid key attends to padding: the result is never used, but it must not be NaN.
    seen = (valid > 0) | (valid.sum(dim=1, keepdim=True) == 0)
    unseen = torch.zeros_like(valid, dtype=query.dtype).masked_fill(~seen, -torch.inf)
    unseen = unseen.repeat_interleave(HEADS, dim=0)[:, None, :].expand(-1, query.shape[1], -1)
    with torch.autocast(query.device.type, enabled=False):  # it would make the weights float32, between 16-bit products
        result: Tensor = torch.softmax(torch.baddbmm(unseen, query, key.transpose(1, 2)), dim=-1) @ value
        return result


def dropout(value: Tensor) -> Tensor:
    """Set a tenth of the values to 0, and scale up the others so that the mean stays.

    Torch draws a random number for each value. Here four values share one of 64 bits, which is four times as fast.
    """
    values = value.numel()
    bits = torch.empty(-(-values * _BITS // 64), dtype=torch.int64, device=value.device).random_(-(2**63), None)
    chance = bits.view(torch.int16)[:values].view(value.shape)
    least = round(DROPOUT * 2**_BITS) - 2 ** (_BITS - 1)
    kept: Tensor = (chance >= least).to(value.dtype)
    return value * (kept / (1.0 - DROPOUT))


def _through(given: Tensor | Embedded, layer: nn.Linear) -> Tensor:
    """Apply a layer (objects, n, 128)."""
    result: Tensor = given.embed_through(layer) if isinstance(given, Embedded) else layer(given)
    return result


def _split_heads(value: Tensor) -> Tensor:
    """Reshape (objects, n, 128) to (objects, 4, n, 32)."""
    return value.view(*value.shape[:2], HEADS, _HEAD_WIDTH).transpose(1, 2)


def _merge_heads(value: Tensor) -> Tensor:
    """Reshape (objects * 4, n, 32) to (objects, n, 128)."""
    return value.view(-1, HEADS, *value.shape[1:]).transpose(1, 2).flatten(2)
