"""Context encoders for the first layer, and context distances for the regulariser.

All of them run once per object, never once per push.
"""

from typing import Final

import torch
from torch import Tensor, nn

from service.pushing.contexts import VISUAL_SIZE
from training.networks.methods import ContextDistance
from training.networks.shape_features import BODY_INPUTS, CONTEXT_INPUTS

CHANNELS: Final = 4  # the paper's
KERNEL_HIDDEN: Final = 10
KERNEL_VECTOR: Final = 5  # phi of a context vector
KERNEL_VISUAL: Final = 10  # phi of a visual context


def context_encoder(context_shape: tuple[int, ...], width: int, channels: int = CHANNELS) -> nn.Module:
    """Return the encoder of contexts (objects, *context_shape) to (objects, width), by their shape."""
    if context_shape == (CONTEXT_INPUTS,):
        return ShapeEncoder(width, channels)
    return nn.Linear(context_shape[0], width) if len(context_shape) == 1 else VisualEncoder(width, channels)


class VisualEncoder(nn.Module):
    """Encoder of views (objects, 1, 32, 32): two times (conv 3x3, batch norm, ReLU, max-pool 2), then a dense layer.

    Batch norm counts each object once. The published loop repeats the context for every push and finds the same mean
    and variance. The published list has another ReLU between pooling and dense layer, which a ReLU before it makes
    redundant.
    """

    def __init__(self, width: int, channels: int = CHANNELS) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(*_convolution(1, channels), *_convolution(channels, channels))
        self.dense = nn.Linear(channels * (VISUAL_SIZE // 4) ** 2, width)

    def forward(self, context: Tensor) -> Tensor:
        """Encode views in 0..1 as (objects, width)."""
        encoded: Tensor = self.dense(self.convolutions(context).flatten(1))
        return encoded


def _convolution(entering: int, channels: int) -> tuple[nn.Module, ...]:
    return nn.Conv2d(entering, channels, 3, padding=1), nn.BatchNorm2d(channels), nn.ReLU(), nn.MaxPool2d(2)


class ShapeEncoder(nn.Module):
    """Encoder of shape contexts (objects, 1032): a visual encoder of the silhouette, plus a dense layer of the body."""

    def __init__(self, width: int, channels: int = CHANNELS) -> None:
        super().__init__()
        self.silhouette = VisualEncoder(width, channels)
        self.body = nn.Linear(BODY_INPUTS, width)

    def forward(self, context: Tensor) -> Tensor:
        """Encode contexts as (objects, width)."""
        views = context[:, :-BODY_INPUTS].reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE)
        encoded: Tensor = self.silhouette(views) + self.body(context[:, -BODY_INPUTS:])
        return encoded


class EuclideanDistance(nn.Module):
    """Euclidean distance ``d(c, c') = |c - c'|`` of the vectorised contexts."""

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Compute the distances (pairs,) of contexts (pairs, ...)."""
        distance: Tensor = torch.linalg.vector_norm((first - second).flatten(1), dim=-1)
        return distance


class KernelDistance(nn.Module):
    """Kernel distance ``d(c, c') = phi(c) . phi(c')``.

    phi is ``W2 max(0, W1 x)`` of a vector and ``W avg-pool(max(0, conv(x)))`` of an image.
    """

    def __init__(self, context_shape: tuple[int, ...]) -> None:
        super().__init__()
        if len(context_shape) == 1:
            layers: tuple[nn.Module, ...] = (
                nn.Linear(context_shape[0], KERNEL_HIDDEN),
                nn.ReLU(),
                nn.Linear(KERNEL_HIDDEN, KERNEL_VECTOR),
            )
        else:
            pooled = (VISUAL_SIZE - 8) // 4 + 1
            layers = (
                nn.Conv2d(1, CHANNELS, 3, padding=1),
                nn.ReLU(),
                nn.AvgPool2d(8, stride=4),
                nn.Flatten(),
                nn.Linear(CHANNELS * pooled**2, KERNEL_VISUAL),
            )
        self.phi = nn.Sequential(*layers)

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Compute the inner products (pairs,) of the embeddings of contexts (pairs, ...)."""
        product: Tensor = (self.phi(first) * self.phi(second)).sum(dim=-1)
        return product


def context_distance(distance: ContextDistance, context_shape: tuple[int, ...]) -> nn.Module | None:
    """Return the distance of a method's regulariser, None for methods without one."""
    if distance is ContextDistance.KERNEL:
        return KernelDistance(context_shape)
    return EuclideanDistance() if distance is ContextDistance.EUCLIDEAN else None
