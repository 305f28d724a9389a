"""Push networks: the paper's fully-connected networks, written from its section III.

All inputs and outputs are normalised (see ``published.Normalisation``). Shapes are (objects, pushes, ...): a context
belongs to an object, so it is encoded once per object and broadcast over the object's pushes.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from service.model.tensors import ContextKind
from service.pushing.contexts import INDICATOR_LENGTH, VISUAL_SIZE
from training.networks.angles import FEATURES_ADDED, PushForm, features, from_push_frame
from training.networks.encoders import CHANNELS, context_distance, context_encoder
from training.networks.methods import ContextUse, Method
from training.networks.mixed_precision import mixed_dense, mixed_first, mixed_last
from training.networks.shape_features import CONTEXT_INPUTS, PUSH_INPUTS

WIDTH: Final = 256
POSE: Final = 3
# Far beyond any fitted value. It keeps std a positive, finite float32 for every input.
LOG_STD_LIMIT: Final = 10.0


@dataclass(frozen=True)
class Shape:
    """Shape of a network: the sizes of its inputs and outputs."""

    context: tuple[int, ...]  # of one object
    inputs: int = POSE
    outputs: int = POSE


PUSH_SHAPES: Final = {
    ContextKind.NONE: Shape((0,)),
    ContextKind.INDICATOR: Shape((INDICATOR_LENGTH,)),
    ContextKind.VISUAL: Shape((1, VISUAL_SIZE, VISUAL_SIZE)),
    ContextKind.SUPPORT: Shape((0,)),  # a neural process draws it from the pushes
    ContextKind.SHAPE: Shape((CONTEXT_INPUTS,), PUSH_INPUTS),
}


def bounded(log_std: Tensor) -> Tensor:
    """Clamp a log std to the limits. Only for fitted networks: a clamped value has no gradient to train with."""
    return log_std.clamp(-LOG_STD_LIMIT, LOG_STD_LIMIT)


def at_least(log_std: Tensor, least_std: float) -> Tensor:
    """Add a least std: log(exp(s) + least), in a form that does not overflow."""
    least = math.log(least_std)
    return least + functional.softplus(log_std - least)


class Prediction(NamedTuple):
    """Prediction: a Gaussian per push, and the conditioning of the first layer by each object's context."""

    mean: Tensor  # (objects, pushes, outputs)
    log_std: Tensor  # (objects, pushes, outputs)
    conditioning: Tensor | None  # (objects, 256): a mask or a shift


class PushNetwork(nn.Module):
    """Network of four dense layers, from pusher pose to a Gaussian over the object's pose, conditioned by the context.

    - FCN: ``g(x) = g4(g3(g2(g1(x))))``
    - FCN + CM: ``g(x, c) = g4(g3(g2(g1(x) * m(c))))`` with ``m(c) = ReLU(e(c))``
    - FCN + CC: ``g1([x, c])``, for a visual context ``ReLU(W x + b + e(c))``

    ``e`` is a dense layer for a vector and the visual encoder for an image. ``distance`` is the d of the context
    regulariser. Its parameters, if any, are trained with the network, but predictions do not depend on it.
    """

    def __init__(
        self,
        method: Method,
        shape: Shape,
        form: PushForm = PushForm.RAW,
        least_std: float = 0.0,
        encoder_channels: int = CHANNELS,
    ) -> None:
        """Create fresh layers. The paper's network has the defaults. ``least_std`` is normalised, see ``Recipe``."""
        super().__init__()
        self.use = method.context_use
        self.form = form
        self.least_std = least_std
        self.inputs = shape.inputs + FEATURES_ADDED[form]
        # One layer takes [x, c], as the paper concatenates. Only its columns for x run once per push.
        joined = self.use is ContextUse.CONCATENATED and len(shape.context) == 1
        self.first = nn.Linear(self.inputs + (shape.context[0] if joined else 0), WIDTH)
        self.second = nn.Linear(WIDTH, WIDTH)
        self.third = nn.Linear(WIDTH, WIDTH)
        self.last = nn.Linear(WIDTH, 2 * shape.outputs)
        encoded = self.use is not ContextUse.NONE and not joined
        self.context_encoder = context_encoder(shape.context, WIDTH, encoder_channels) if encoded else None
        self.distance = context_distance(method.distance, shape.context)

    def conditioning(self, context: Tensor) -> Tensor | None:
        """Compute the first layer's conditioning, masks or shifts (objects, 256), of contexts (objects, *context)."""
        if self.use is ContextUse.NONE:
            return None
        if self.context_encoder is None:
            return functional.linear(context, self.first.weight[:, self.inputs :])
        encoded: Tensor = self.context_encoder(context)
        return torch.relu(encoded) if self.use is ContextUse.MASKED else encoded

    def gaussian(self, pusher: Tensor, conditioning: Tensor | None) -> tuple[Tensor, Tensor]:
        """Predict mean and log std (n, 3) of pusher poses (n, 3), each with its own row of conditioning (n, 256)."""
        entering = features(pusher, self.form)
        hidden = functional.linear(entering, self.first.weight[:, : self.inputs], self.first.bias)
        if conditioning is not None and self.use is ContextUse.CONCATENATED:
            hidden = hidden + conditioning
        hidden = torch.relu(hidden)
        if conditioning is not None and self.use is ContextUse.MASKED:
            hidden = hidden * conditioning
        return self._upper_layers(hidden, pusher)

    def push_parameters(self) -> list[nn.Parameter]:
        """Return the parameters of the layers that take every push. The other layers take contexts."""
        return [value for layer in (self.first, self.second, self.third, self.last) for value in layer.parameters()]

    def forward(self, pusher: Tensor, context: Tensor) -> Prediction:
        """Predict pushes (objects, pushes, 3) of objects with contexts (objects, *context)."""
        conditioning = self.conditioning(context)
        return Prediction(*self.conditioned(pusher, conditioning), conditioning)

    def conditioned(
        self, pusher: Tensor, conditioning: Tensor | None, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor]:
        """Predict mean and log std of pushes (objects, pushes, 3) of objects with this conditioning (objects, 256).

        ``dtype`` is the type of the products, see ``mixed_precision``. Inputs and outputs are float32.
        """
        entering = features(pusher, self.form)
        weight: Tensor = self.first.weight[:, : self.inputs].T
        bias: Tensor = self.first.bias
        if conditioning is None:
            weight, bias = weight.expand(len(pusher), -1, -1), bias.expand(len(pusher), -1)
        elif self.use is ContextUse.MASKED:
            # A mask is never negative, so ReLU(W x + b) * m = ReLU((m W) x + m b). Masked weights cost one pass per
            # object, masked activations would cost one pass per push.
            weight, bias = weight * conditioning[:, None, :], bias * conditioning
        else:
            weight, bias = weight.expand(len(pusher), -1, -1), bias + conditioning
        if dtype == torch.float32:
            return self._upper_layers(torch.relu_(torch.baddbmm(bias[:, None, :], entering, weight)), pusher)
        hidden = mixed_first(entering, weight, bias[:, None, :], dtype).flatten(0, -2)
        for layer in (self.second, self.third):
            hidden = mixed_dense(hidden, layer.weight, layer.bias)
        out = mixed_last(hidden, self.last.weight, self.last.bias)
        return self._mean_and_log_std(out.view(*pusher.shape[:-1], -1), pusher)

    def _upper_layers(self, hidden: Tensor, pusher: Tensor) -> tuple[Tensor, Tensor]:
        for layer in (self.second, self.third):
            hidden = torch.relu(layer(hidden))
        return self._mean_and_log_std(self.last(hidden), pusher)

    def _mean_and_log_std(self, out: Tensor, pusher: Tensor) -> tuple[Tensor, Tensor]:
        """Split the output of the last layer into mean and log std."""
        mean, log_std = out.chunk(2, dim=-1)
        mean = from_push_frame(mean, pusher) if self.form is PushForm.PUSH_FRAME else mean
        log_std = log_std if self.training else bounded(log_std)
        return mean, log_std if self.least_std == 0.0 else at_least(log_std, self.least_std)
