"""The paper's networks for the indicator context, written from its section III and the design's table.

Everything is normalised here (see ``data.Normalisation``); shapes are (objects, pushes, ...), since the context belongs
to the object: the mask is computed once per object and broadcast over its pushes, never once per push.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from service.contract import INDICATOR_LENGTH, ContextKind

WIDTH: Final = 256
POSE: Final = 3
# Far beyond any fitted value: it keeps std a positive, finite float32 whatever the input.
LOG_STD_LIMIT: Final = 10.0


@dataclass(frozen=True)
class Method:
    """A row of the paper's tables."""

    name: str
    masked: bool
    regularised: bool

    @property
    def context_kind(self) -> ContextKind:
        """What the network wants to know of the object."""
        return ContextKind.INDICATOR if self.masked else ContextKind.NONE


METHODS: Final = {
    method.name: method
    for method in (
        Method("FCN", masked=False, regularised=False),
        Method("FCN + CM", masked=True, regularised=False),
        Method("FCN + CM + L2Reg", masked=True, regularised=True),
    )
}


class Prediction(NamedTuple):
    """A Gaussian per push and, where the network has one, the mask per object."""

    mean: Tensor  # (objects, pushes, 3)
    log_std: Tensor  # (objects, pushes, 3)
    mask: Tensor | None  # (objects, 256)


class PushNetwork(nn.Module):
    """Four dense layers from pusher pose to a Gaussian over the object's pose, the first masked by the context.

    ``g(x, c) = g4(g3(g2(g1(x) * m(c))))`` with ``m(c) = ReLU(W c + b)``; without a mask it is the paper's FCN.
    """

    def __init__(self, masked: bool) -> None:
        super().__init__()
        self.first = nn.Linear(POSE, WIDTH)
        self.second = nn.Linear(WIDTH, WIDTH)
        self.third = nn.Linear(WIDTH, WIDTH)
        self.last = nn.Linear(WIDTH, 2 * POSE)
        self.context_mask = nn.Linear(INDICATOR_LENGTH, WIDTH) if masked else None

    def mask(self, context: Tensor) -> Tensor | None:
        """m(c), (objects, 256), of contexts (objects, 36)."""
        return None if self.context_mask is None else torch.relu(self.context_mask(context))

    def gaussian(self, pusher: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor]:
        """Mean and log std (n, 3) of pusher poses (n, 3), each under its own row of masks (n, 256)."""
        hidden = torch.relu(self.first(pusher))
        return self._upper_layers(hidden if mask is None else hidden * mask)

    def forward(self, pusher: Tensor, context: Tensor) -> Prediction:
        """Predict pushes (objects, pushes, 3) of objects with these contexts (objects, 36)."""
        mask = self.mask(context)
        if mask is None:
            return Prediction(*self.gaussian(pusher, None), None)
        # ReLU(W x + b) * m = ReLU((m W) x + m b), since a mask is never negative: multiplied into the weights it costs
        # a pass per object, multiplied onto the activations a pass per push
        weight = (self.first.weight * mask[:, :, None]).transpose(1, 2)  # (objects, 3, 256)
        bias = (self.first.bias * mask)[:, None, :]  # (objects, 1, 256)
        return Prediction(*self._upper_layers(torch.relu(torch.baddbmm(bias, pusher, weight))), mask)

    def _upper_layers(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        hidden = torch.relu(self.second(hidden))
        hidden = torch.relu(self.third(hidden))
        mean, log_std = torch.split(self.last(hidden), POSE, dim=-1)
        return mean, log_std.clamp(-LOG_STD_LIMIT, LOG_STD_LIMIT)
