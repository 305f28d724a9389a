"""Familiarity: how far a query lies outside of the training data, in units of how far the training data reach.

A distance of 1 is the edge of the domain that a model vouches for, and more is outside. ``FeatureRanges`` knows each
named feature by itself, as a range that people can read. ``FeatureSpace`` knows how features occur together: along the
principal axes of the data, and away from them. Both are exported with the graph, and neither has a loop.
"""

from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor, nn

_LEAST: Final = 1e-6  # of a half width or a deviation: a feature that is always the same allows only that value
_FURTHEST: Final = 1e6  # keeps the distance of any input finite


class FeatureRanges(nn.Module):
    """Distance of features (n, f) from ranges: 1 at the edge of the feature that is furthest out, 0 in the middle."""

    def __init__(self, names: Sequence[str]) -> None:
        """Create ranges of named features. Until ``fit``, nothing is familiar."""
        super().__init__()
        self.names = tuple(names)
        self.low = nn.Buffer(torch.zeros(len(self.names)))
        self.high = nn.Buffer(torch.zeros(len(self.names)))

    def fit(self, features: Tensor, left_out: float = 0.0, margin: float = 0.0) -> "FeatureRanges":
        """Take the ranges of training features (n, f), without a share ``left_out`` at each end.

        ``margin`` widens each range at both ends, by a share of its width. A range without negative values stays so.
        """
        ordered = features.sort(dim=0).values
        skipped = int(left_out * len(ordered))
        low, high = ordered[skipped], ordered[len(ordered) - 1 - skipped]
        room = margin * (high - low)
        self.low.copy_(torch.where(low >= 0.0, torch.clamp(low - room, min=0.0), low - room))
        self.high.copy_(high + room)
        return self

    def forward(self, features: Tensor) -> Tensor:
        """Return the distances (n,) of features (n, f)."""
        half = torch.clamp(0.5 * (self.high - self.low), min=_LEAST)
        away = torch.abs(features - 0.5 * (self.high + self.low)) / half
        return torch.clamp(away.amax(dim=-1), max=_FURTHEST)

    def ranges(self) -> dict[str, list[float]]:
        """Return [low, high] of each feature by its name, for the manifest."""
        return {name: [low, high] for name, low, high in zip(self.names, *self._edges(), strict=True)}

    def _edges(self) -> tuple[list[float], list[float]]:
        return self.low.tolist(), self.high.tolist()


class FeatureSpace(nn.Module):
    """Distance of features (n, f) from training data along their principal axes, and of the remainder from zero.

    The distance along the axes is that of Mahalanobis. The remainder is the part of a feature vector that the axes do
    not span, as a novelty detector by principal components has it. Each is divided by the ``threshold`` that nearly all
    familiar features stay below, and the larger one counts.
    """

    def __init__(self, width: int, axes: int) -> None:
        """Create a space of ``width`` features and ``axes`` principal axes. Until ``fit``, nothing is familiar."""
        super().__init__()
        self.centre = nn.Buffer(torch.zeros(width))
        self.axes = nn.Buffer(torch.zeros(width, axes))  # orthonormal
        self.spread = nn.Buffer(torch.ones(axes))  # standard deviation along each axis
        self.threshold = nn.Buffer(torch.full((2,), _LEAST))  # of both distances

    def fit(self, features: Tensor, familiar: Tensor, false_alarms: float = 0.005) -> "FeatureSpace":
        """Fit the axes to training features (n, f), and the thresholds to other features of the same kind.

        ``familiar`` features are best of objects that the axes were not fitted to. A share ``false_alarms`` of them
        lies outside of each threshold.
        """
        centre = features.double().mean(dim=0)
        away = features.double() - centre
        values, vectors = torch.linalg.eigh(away.T @ away / len(away))  # ascending
        count = self.spread.shape[0]
        self.centre.copy_(centre)
        self.axes.copy_(vectors[:, -count:])
        self.spread.copy_(values[-count:].clamp(min=_LEAST**2).sqrt())
        self.threshold.copy_(torch.quantile(self.distances(familiar), 1.0 - false_alarms, dim=0).clamp(min=_LEAST))
        return self

    def distances(self, features: Tensor) -> Tensor:
        """Return both distances (n, 2) of features (n, f): along the axes, and of the remainder."""
        away = features - self.centre
        along = away @ self.axes
        remainder = away - along @ self.axes.T
        return torch.stack(
            [torch.linalg.vector_norm(along / self.spread, dim=-1), torch.linalg.vector_norm(remainder, dim=-1)], dim=-1
        )

    def forward(self, features: Tensor) -> Tensor:
        """Return the distances (n,) of features (n, f)."""
        return torch.clamp((self.distances(features) / self.threshold).amax(dim=-1), max=_FURTHEST)
