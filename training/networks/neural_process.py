"""Neural process: the paper's meta-learning baseline, an attentive neural process (Kim et al., ICLR 2019).

It is given some pushes of an object with their outcomes (the support) before it predicts others (the targets). No
zero-shot method needs that. The process is a yardstick and is never served. Objects are one axis of every tensor, so a
batch of 64 objects is one pass. The module is written from the equations:

- deterministic path: r(x) = cross-attention from x to the support's x over the encoded support
- latent path: z ~ N(mu, sigma^2) of the mean of the encoded points. The support gives the prior, the targets give the
  posterior
- decoder: (x, r(x), z) to a Gaussian over the outcome

Training draws z from the posterior and adds the divergence of posterior from prior to the loss. Evaluation takes the
mean of the prior. (See ``fitting/neural_process_step``, also for the leak of targets in the published evaluation.)
"""

from dataclasses import dataclass
from typing import Final, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from training.networks.attention import WIDTH, Attention, Embedded
from training.networks.mixed_precision import mixed_last
from training.networks.push_network import POSE, bounded

ATTENTION_LAYERS: Final = 2
DECODER_WIDTH: Final = 3 * WIDTH
DECODER_LAYERS: Final = 3


@dataclass(frozen=True)
class Points:
    """Points: some pushes of each object with their outcomes."""

    inputs: Tensor  # (objects, n, inputs)
    targets: Tensor  # (objects, n, outputs)
    valid: Tensor  # (objects, n)


class PointEncoder(nn.Module):
    """Encoder of points: a dense layer, then two layers of self-attention between the points of an object."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.embed = nn.Linear(inputs + outputs, WIDTH)
        self.layers = nn.ModuleList(Attention() for _ in range(ATTENTION_LAYERS))

    def forward(self, points: Points) -> Tensor:
        """Encode points as (objects, n, 128)."""
        embedded = Embedded(torch.cat([points.inputs, points.targets], dim=-1), self.embed)
        first, *others = self.layers
        encoded: Tensor = first(embedded, embedded, embedded, points.valid)
        for layer in others:
            encoded = layer(encoded, encoded, encoded, points.valid)
        return encoded


class NeuralProcess(nn.Module):
    """Attentive neural process."""

    def __init__(self, inputs: int = POSE, outputs: int = POSE) -> None:
        super().__init__()
        self.latent_points = PointEncoder(inputs, outputs)
        self.latent_hidden = nn.Linear(WIDTH, WIDTH)
        self.latent_mean = nn.Linear(WIDTH, WIDTH)
        self.latent_std = nn.Linear(WIDTH, WIDTH)
        self.support_points = PointEncoder(inputs, outputs)
        self.place = nn.Linear(inputs, WIDTH)  # embeds queries and keys
        self.cross = nn.ModuleList(Attention() for _ in range(ATTENTION_LAYERS))
        self.target_input = nn.Linear(inputs, WIDTH)
        self.decoder = nn.ModuleList(nn.Linear(DECODER_WIDTH, DECODER_WIDTH) for _ in range(DECODER_LAYERS))
        self.last = nn.Linear(DECODER_WIDTH, 2 * outputs)

    def latent(self, points: Points) -> tuple[Tensor, Tensor]:
        """Compute mean and std of z, (objects, 128) each, given these points."""
        encoded = self.latent_points(points)
        weight = points.valid[..., None]
        average = (encoded * weight).sum(dim=1) / weight.sum(dim=1).clamp(min=1.0)
        hidden = torch.relu(self.latent_hidden(average))
        return self.latent_mean(hidden), 0.1 + 0.9 * torch.sigmoid(self.latent_std(hidden))

    def decode(self, support: Points, inputs: Tensor, latent: Tensor) -> tuple[Tensor, Tensor]:
        """Predict mean and log std (objects, n, outputs) of the outcomes of inputs (objects, n, inputs)."""
        encoded = self.support_points(support)
        keys, (first, *others) = Embedded(support.inputs, self.place), self.cross
        found: Tensor = first(Embedded(inputs, self.place), keys, encoded, support.valid)
        for layer in others:
            found = layer(found, keys, encoded, support.valid)
        hidden = torch.relu(self._first_decoder_layer(inputs, found, latent))
        for dense in self.decoder[1:]:
            hidden = torch.relu(dense(hidden))
        # The Gaussian is float32, also where the layers' products are 16-bit.
        with torch.autocast(hidden.device.type, enabled=False):
            out = mixed_last(hidden.flatten(0, 1), self.last.weight, self.last.bias)
        mean, log_std = out.view(*inputs.shape[:-1], -1).chunk(2, dim=-1)
        return mean, log_std if self.training else bounded(log_std)

    def _first_decoder_layer(self, inputs: Tensor, found: Tensor, latent: Tensor) -> Tensor:
        """Apply the decoder's first layer to ``[target_input(x), r(x), z]``, each by its own columns, z per object."""
        dense = cast(nn.Linear, self.decoder[0])
        of_input, of_found, of_latent = dense.weight.chunk(3, dim=1)
        same = functional.linear(latent, of_latent, dense.bias) + of_input @ self.target_input.bias
        weight = (of_input @ self.target_input.weight).T.expand(len(inputs), -1, -1)
        joined = torch.baddbmm(same[:, None, :], inputs, weight)
        return torch.addmm(joined.flatten(0, 1), found.flatten(0, 1), of_found.T).view_as(joined)

    def forward(self, support: Points, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Predict the outcomes of inputs (objects, n, inputs) with the mean of the prior."""
        return self.decode(support, inputs, self.latent(support)[0])
