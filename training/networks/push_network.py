"""The paper's fully-connected networks, written from its section III and the design's table.

Everything is normalised here (see ``published.Normalisation``); shapes are (objects, pushes, ...), since the context
belongs to the object: it is encoded once per object and broadcast over its pushes, never once per push.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from service.model.tensors import ContextKind
from service.pushing.contexts import INDICATOR_LENGTH, VISUAL_SIZE
from training.networks.angles import circular
from training.networks.encoders import context_distance, context_encoder
from training.networks.methods import ContextUse, Method
from training.networks.mixed_precision import rounded_dense, rounded_first, rounded_last

WIDTH: Final = 256
POSE: Final = 3
# Far beyond any fitted value: it keeps std a positive, finite float32 whatever the input.
LOG_STD_LIMIT: Final = 10.0


@dataclass(frozen=True)
class Shape:
    """What goes into a network and what comes out."""

    context: tuple[int, ...]  # of one object
    inputs: int = POSE
    outputs: int = POSE


PUSH_SHAPES: Final = {
    ContextKind.NONE: Shape((0,)),
    ContextKind.INDICATOR: Shape((INDICATOR_LENGTH,)),
    ContextKind.VISUAL: Shape((1, VISUAL_SIZE, VISUAL_SIZE)),
}


def bounded(log_std: Tensor) -> Tensor:
    """Within the limits; for fitted networks only, since a bound has no slope by which training could come back."""
    return log_std.clamp(-LOG_STD_LIMIT, LOG_STD_LIMIT)


class Prediction(NamedTuple):
    """A Gaussian per push and what the context of each object did to the first layer."""

    mean: Tensor  # (objects, pushes, outputs)
    log_std: Tensor  # (objects, pushes, outputs)
    conditioning: Tensor | None  # (objects, 256): a mask or a shift


class PushNetwork(nn.Module):
    """Four dense layers from pusher pose to a Gaussian over the object's pose, the first conditioned by the context.

    - FCN: ``g(x) = g4(g3(g2(g1(x))))``
    - FCN + CM: ``g(x, c) = g4(g3(g2(g1(x) * m(c))))`` with ``m(c) = ReLU(e(c))``
    - FCN + CC: ``g1([x, c])``, of a visual context ``ReLU(W x + b + e(c))``

    ``e`` is a dense layer of a vector and the visual encoder of an image. ``distance`` is the d of the context
    regulariser, learnt along where it has parameters; predictions do not depend on it.
    """

    def __init__(self, method: Method, shape: Shape, circular_angle: bool = False, least_std: float = 0.0) -> None:
        """``circular_angle`` and ``least_std`` (normalised units) go beyond the paper, see ``recipes.Recipe``."""
        super().__init__()
        self.use = method.context_use
        self.circular_angle = circular_angle
        self.least_std = least_std
        self.inputs = shape.inputs + circular_angle
        # [x, c] through one layer, as the paper concatenates; only its share of x meets every push
        joined = self.use is ContextUse.CONCATENATED and len(shape.context) == 1
        self.first = nn.Linear(self.inputs + (shape.context[0] if joined else 0), WIDTH)
        self.second = nn.Linear(WIDTH, WIDTH)
        self.third = nn.Linear(WIDTH, WIDTH)
        self.last = nn.Linear(WIDTH, 2 * shape.outputs)
        encoded = self.use is not ContextUse.NONE and not joined
        self.context_encoder = context_encoder(shape.context, WIDTH) if encoded else None
        self.distance = context_distance(method.distance, shape.context)

    def conditioning(self, context: Tensor) -> Tensor | None:
        """What the first layer takes of objects (objects, *context): their masks, or their shifts, (objects, 256)."""
        if self.use is ContextUse.NONE:
            return None
        if self.context_encoder is None:
            return functional.linear(context, self.first.weight[:, self.inputs :])
        encoded: Tensor = self.context_encoder(context)
        return torch.relu(encoded) if self.use is ContextUse.MASKED else encoded

    def gaussian(self, pusher: Tensor, conditioning: Tensor | None) -> tuple[Tensor, Tensor]:
        """Mean and log std (n, 3) of pusher poses (n, 3), each under its own row of conditioning (n, 256)."""
        pusher = circular(pusher) if self.circular_angle else pusher
        hidden = functional.linear(pusher, self.first.weight[:, : self.inputs], self.first.bias)
        if conditioning is not None and self.use is ContextUse.CONCATENATED:
            hidden = hidden + conditioning
        hidden = torch.relu(hidden)
        if conditioning is not None and self.use is ContextUse.MASKED:
            hidden = hidden * conditioning
        return self._upper_layers(hidden)

    def push_parameters(self) -> list[nn.Parameter]:
        """Those of the layers that every push goes through; the others meet contexts alone."""
        return [value for layer in (self.first, self.second, self.third, self.last) for value in layer.parameters()]

    def forward(self, pusher: Tensor, context: Tensor) -> Prediction:
        """Predict pushes (objects, pushes, 3) of objects with these contexts."""
        conditioning = self.conditioning(context)
        return Prediction(*self.conditioned(pusher, conditioning), conditioning)

    def conditioned(
        self, pusher: Tensor, conditioning: Tensor | None, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor]:
        """Mean and log std of pushes (objects, pushes, 3) of objects with this conditioning (objects, 256).

        ``dtype`` is that of the products, see ``rounded``; what goes in and comes out is float32.
        """
        pusher = circular(pusher) if self.circular_angle else pusher
        weight: Tensor = self.first.weight[:, : self.inputs].T
        bias: Tensor = self.first.bias
        if conditioning is None:
            weight, bias = weight.expand(len(pusher), -1, -1), bias.expand(len(pusher), -1)
        elif self.use is ContextUse.MASKED:
            # ReLU(W x + b) * m = ReLU((m W) x + m b), since a mask is never negative: multiplied into the weights it
            # costs a pass per object, multiplied onto the activations a pass per push
            weight, bias = weight * conditioning[:, None, :], bias * conditioning
        else:
            weight, bias = weight.expand(len(pusher), -1, -1), bias + conditioning
        if dtype == torch.float32:
            return self._upper_layers(torch.relu_(torch.baddbmm(bias[:, None, :], pusher, weight)))
        hidden = rounded_first(pusher, weight, bias[:, None, :], dtype).flatten(0, -2)
        for layer in (self.second, self.third):
            hidden = rounded_dense(hidden, layer.weight, layer.bias)
        out = rounded_last(hidden, self.last.weight, self.last.bias)
        return self._halves(out.view(*pusher.shape[:-1], -1))

    def _upper_layers(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        for layer in (self.second, self.third):
            hidden = torch.relu(layer(hidden))
        return self._halves(self.last(hidden))

    def _halves(self, out: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log std of what the last layer gives."""
        mean, log_std = out.chunk(2, dim=-1)
        log_std = log_std if self.training else bounded(log_std)
        if self.least_std > 0.0:  # log(exp(s) + least), written so that it never overflows
            least = math.log(self.least_std)
            log_std = least + functional.softplus(log_std - least)
        return mean, log_std
