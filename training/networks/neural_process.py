"""The paper's meta-learning baseline: an attentive neural process (Kim et al., ICLR 2019), written from its equations.

It sees some pushes of the very object with their outcomes (the support) before it predicts others (the targets), which
no zero-shot method does; it is a yardstick and is never served. Objects are one axis of every tensor, so a batch of 64
objects is one pass.

- deterministic path: r(x) = cross-attention from x to the support's x over the encoded support
- latent path: z ~ N(mu, sigma^2) of the mean of the encoded points; from the support it is the prior, from the targets
  the posterior
- decoder: (x, r(x), z) to a Gaussian over the outcome

Fitted with z of the posterior and the divergence of posterior from prior; evaluated with the mean of the prior. (The
published evaluation encodes the very targets that it is asked for; ``leak`` does so too, for the figure beside ours.)
"""

from dataclasses import dataclass
from typing import Final, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from training.networks.attention import WIDTH, Attention, Embedded
from training.networks.mixed_precision import rounded_last
from training.networks.push_network import POSE, bounded

ATTENTION_LAYERS: Final = 2
DECODER_WIDTH: Final = 3 * WIDTH
DECODER_LAYERS: Final = 3


@dataclass(frozen=True)
class Points:
    """Some pushes of each object with their outcomes."""

    inputs: Tensor  # (objects, n, inputs)
    targets: Tensor  # (objects, n, outputs)
    valid: Tensor  # (objects, n)


class PointEncoder(nn.Module):
    """Pushes with their outcomes, each in the light of the others: a dense layer and two layers of self-attention."""

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
    """The attentive neural process."""

    def __init__(self, inputs: int = POSE, outputs: int = POSE) -> None:
        super().__init__()
        self.latent_points = PointEncoder(inputs, outputs)
        self.latent_hidden = nn.Linear(WIDTH, WIDTH)
        self.latent_mean = nn.Linear(WIDTH, WIDTH)
        self.latent_std = nn.Linear(WIDTH, WIDTH)
        self.support_points = PointEncoder(inputs, outputs)
        self.place = nn.Linear(inputs, WIDTH)  # of queries and keys alike
        self.cross = nn.ModuleList(Attention() for _ in range(ATTENTION_LAYERS))
        self.target_input = nn.Linear(inputs, WIDTH)
        self.decoder = nn.ModuleList(nn.Linear(DECODER_WIDTH, DECODER_WIDTH) for _ in range(DECODER_LAYERS))
        self.last = nn.Linear(DECODER_WIDTH, 2 * outputs)

    def latent(self, points: Points) -> tuple[Tensor, Tensor]:
        """Mean and std of z, (objects, 128) each, given these points."""
        encoded = self.latent_points(points)
        weight = points.valid[..., None]
        average = (encoded * weight).sum(dim=1) / weight.sum(dim=1).clamp(min=1.0)
        hidden = torch.relu(self.latent_hidden(average))
        return self.latent_mean(hidden), 0.1 + 0.9 * torch.sigmoid(self.latent_std(hidden))

    def decode(self, support: Points, inputs: Tensor, latent: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log std (objects, n, outputs) of the outcomes of inputs (objects, n, inputs)."""
        encoded = self.support_points(support)
        keys, (first, *others) = Embedded(support.inputs, self.place), self.cross
        found: Tensor = first(Embedded(inputs, self.place), keys, encoded, support.valid)
        for layer in others:
            found = layer(found, keys, encoded, support.valid)
        hidden = torch.relu(self._joined(inputs, found, latent))
        for dense in self.decoder[1:]:
            hidden = torch.relu(dense(hidden))
        # the Gaussian itself in float32, whatever the layers were multiplied in
        with torch.autocast(hidden.device.type, enabled=False):
            out = rounded_last(hidden.flatten(0, 1), self.last.weight, self.last.bias)
        mean, log_std = out.view(*inputs.shape[:-1], -1).chunk(2, dim=-1)
        return mean, log_std if self.training else bounded(log_std)

    def _joined(self, inputs: Tensor, found: Tensor, latent: Tensor) -> Tensor:
        """The decoder's first layer of ``[target_input(x), r(x), z]``, each by its own columns; z once per object."""
        dense = cast(nn.Linear, self.decoder[0])
        of_input, of_found, of_latent = dense.weight.chunk(3, dim=1)
        same = functional.linear(latent, of_latent, dense.bias) + of_input @ self.target_input.bias
        weight = (of_input @ self.target_input.weight).T.expand(len(inputs), -1, -1)
        joined = torch.baddbmm(same[:, None, :], inputs, weight)
        return torch.addmm(joined.flatten(0, 1), found.flatten(0, 1), of_found.T).view_as(joined)

    def forward(self, support: Points, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Predict with the mean of the prior: nothing of the targets but their inputs is known."""
        return self.decode(support, inputs, self.latent(support)[0])
