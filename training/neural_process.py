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

import math
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from training.losses import gaussian_divergence, gaussian_nll
from training.networks import POSE, Prediction, bounded
from training.samples import Samples

WIDTH: Final = 128
HEADS: Final = 4
ATTENTION_LAYERS: Final = 2
DROPOUT: Final = 0.1
DECODER_WIDTH: Final = 3 * WIDTH
DECODER_LAYERS: Final = 3
SUPPORT: Final = 50
SUPPORT_SHARE: Final = 0.2  # of objects with fewer pushes than Omnipush's 250


@dataclass(frozen=True)
class Points:
    """Some pushes of each object with their outcomes."""

    inputs: Tensor  # (objects, n, inputs)
    targets: Tensor  # (objects, n, outputs)
    valid: Tensor  # (objects, n)


class Attention(nn.Module):
    """Multi-head attention, then dropout, the sum with the queries, and layer norm."""

    def __init__(self) -> None:
        super().__init__()
        self.query, self.key, self.value, self.mixture = (nn.Linear(WIDTH, WIDTH) for _ in range(4))
        self.dropout = nn.Dropout(DROPOUT)
        self.norm = nn.LayerNorm(WIDTH)

    def forward(self, queries: Tensor, keys: Tensor, values: Tensor, valid: Tensor) -> Tensor:
        """Attend from (objects, n, 128) to those of (objects, m, 128) that are valid (objects, m)."""
        query, key, value = (
            self._heads(layer(given))
            for layer, given in ((self.query, queries), (self.key, keys), (self.value, values))
        )
        # an object without a single key attends to padding: the result is never used, but it must not be NaN
        seen = (valid > 0) | (valid.sum(dim=1, keepdim=True) == 0)
        unseen = torch.zeros_like(valid).masked_fill(~seen, -torch.inf)[:, None, None, :].to(query.dtype)
        # two products and a softmax: on a processor, torch's fused attention takes several times as long to go back
        shares = torch.softmax((query / math.sqrt(WIDTH // HEADS)) @ key.transpose(-2, -1) + unseen, dim=-1)
        attended = shares.to(value.dtype) @ value
        together = self.mixture(attended.transpose(1, 2).flatten(2))
        result: Tensor = self.norm(queries + self.dropout(together))
        return result

    @staticmethod
    def _heads(value: Tensor) -> Tensor:
        return value.view(*value.shape[:2], HEADS, WIDTH // HEADS).transpose(1, 2)  # (objects, heads, n, 32)


class PointEncoder(nn.Module):
    """Pushes with their outcomes, each in the light of the others: a dense layer and two layers of self-attention."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.embed = nn.Linear(inputs + outputs, WIDTH)
        self.layers = nn.ModuleList(Attention() for _ in range(ATTENTION_LAYERS))

    def forward(self, points: Points) -> Tensor:
        """Encode points as (objects, n, 128)."""
        encoded: Tensor = self.embed(torch.cat([points.inputs, points.targets], dim=-1))
        for layer in self.layers:
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
        found, keys = self.place(inputs), self.place(support.inputs)
        for layer in self.cross:
            found = layer(found, keys, encoded, support.valid)
        everywhere = latent[:, None, :].expand(-1, inputs.shape[1], -1)
        hidden = torch.cat([self.target_input(inputs), found, everywhere.to(found.dtype)], dim=-1)
        for dense in self.decoder:
            hidden = torch.relu(dense(hidden))
        # the Gaussian itself in float32, whatever the layers were multiplied in
        with torch.autocast(hidden.device.type, enabled=False):
            mean, log_std = self.last(hidden.to(self.last.weight.dtype)).chunk(2, dim=-1)
        return mean, log_std if self.training else bounded(log_std)

    def forward(self, support: Points, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Predict with the mean of the prior: nothing of the targets but their inputs is known."""
        return self.decode(support, inputs, self.latent(support)[0])


def divide(samples: Samples) -> tuple[Points, Points]:
    """Draw each object's support, 50 of its pushes, from torch's generator; the others are the targets.

    Support comes before padding: an object with a single push has it as support and no target.
    """
    rows = samples.valid.shape[1]
    count = min(SUPPORT, max(1, round(SUPPORT_SHARE * rows)))
    order = (torch.rand(samples.valid.shape).to(samples.valid.device) + (1.0 - samples.valid)).argsort(dim=1)
    pick = order[..., None]
    inputs, targets = samples.inputs.take_along_dim(pick, 1), samples.targets.take_along_dim(pick, 1)
    valid = samples.valid.take_along_dim(order, 1)
    return (
        Points(inputs[:, :count], targets[:, :count], valid[:, :count]),
        Points(inputs[:, count:], targets[:, count:], valid[:, count:]),
    )


def loss_terms(network: NeuralProcess, samples: Samples, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """The two terms of the evidence bound, per target value: negative log likelihood, and divergence from the prior."""
    support, targets = divide(samples)
    with torch.autocast(samples.inputs.device.type, dtype=dtype, enabled=dtype != torch.float32):
        posterior_mean, posterior_std = (value.float() for value in network.latent(targets))
        prior_mean, prior_std = (value.float() for value in network.latent(support))
        drawn = posterior_mean + posterior_std * torch.randn_like(posterior_std)
        mean, log_std = network.decode(support, targets.inputs, drawn)
    values = targets.valid.sum() * targets.targets.shape[-1]
    divergence = gaussian_divergence(posterior_mean, posterior_std, prior_mean, prior_std)
    divergence = (divergence * targets.valid.amax(dim=1)).sum() / values  # none where there is no target
    return gaussian_nll(mean, log_std, targets.targets, targets.valid), divergence


def set_gradients(network: NeuralProcess, samples: Samples, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Set the gradient of the bound in every parameter; its two terms."""
    network.zero_grad()
    likelihood, divergence = loss_terms(network, samples, dtype)
    torch.autograd.backward(likelihood + divergence)
    return likelihood.detach(), divergence.detach()


def predict_targets(
    network: NeuralProcess, samples: Samples, seed: int = 0, leak: bool = False
) -> tuple[Prediction, Points]:
    """Gaussians for the targets of a division that depends on the seed alone, and these targets.

    With ``leak`` the latent variable is the posterior's mean, which knows the outcomes: only to show what that does.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        support, targets = divide(samples)
    latent = network.latent(targets if leak else support)[0]
    return Prediction(*network.decode(support, targets.inputs, latent), None), targets
