"""Neural process: the paper's meta-learner, an attentive neural process (Kim et al., ICLR 2019).

It is given some pushes of an object with their outcomes (the support) before it predicts others (the targets). No
zero-shot method needs that. Objects are one axis of every tensor, so a batch of 64 objects is one pass. The module is
written from the equations:

- deterministic path: r(x) = cross-attention from x to the support's x over the encoded support
- latent path: z ~ N(mu, sigma^2) of the mean of the encoded points. The support gives the prior, the targets give the
  posterior
- decoder: (x, r(x), z) to a Gaussian over the outcome

Training draws z from the posterior and adds the divergence of posterior from prior to the loss. Evaluation takes the
mean of the prior. (See ``fitting/neural_process_step``, also for the leak of targets in the published evaluation.)
"""

from dataclasses import dataclass
from typing import Final, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from training.networks.angles import FEATURES_ADDED, PushForm, features, from_push_frame, into_push_frame
from training.networks.attention import WIDTH, Attention, Embedded, Memory
from training.networks.mixed_precision import mixed_last
from training.networks.push_network import POSE, at_least, bounded

ATTENTION_LAYERS: Final = 2
DECODER_WIDTH: Final = 3 * WIDTH
DECODER_LAYERS: Final = 3


@dataclass(frozen=True)
class Points:
    """Points: some pushes of each object with their outcomes."""

    inputs: Tensor  # (objects, n, inputs)
    targets: Tensor  # (objects, n, outputs)
    valid: Tensor  # (objects, n)

    def first(self, count: int) -> "Points":
        """Return at most this many points of each object."""
        return Points(self.inputs[:, :count], self.targets[:, :count], self.valid[:, :count])


class Adapted(NamedTuple):
    """All that a process knows of objects from their supports."""

    memories: tuple[Memory, ...]  # of each layer of the cross-attention
    valid: Tensor  # (objects, m)
    latent: Tensor  # (objects, 128): the mean of the prior

    def of(self, index: Tensor) -> "Adapted":
        """Return the knowledge of some objects (n,), in this order."""
        valid, latent = (torch.index_select(value, 0, index) for value in (self.valid, self.latent))
        return Adapted(tuple(memory.of(index) for memory in self.memories), valid, latent)


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
    """Attentive neural process.

    Poses are normalised (see ``published.Normalisation``). In the form of a push frame, pushes enter with the way they
    pass the object's centre, and their outcomes, given and predicted, are in their own frames.
    """

    def __init__(
        self, inputs: int = POSE, outputs: int = POSE, form: PushForm = PushForm.RAW, least_std: float = 0.0
    ) -> None:
        """Create fresh layers. The paper's process has the defaults. ``least_std`` is normalised, see ``Recipe``."""
        super().__init__()
        self.form = form
        self.least_std = least_std
        inputs += FEATURES_ADDED[form]
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
        encoded = self.latent_points(self._entering(points))
        # Two rows of weights, of which one counts: onnxruntime sums and multiplies the one row of a single object in
        # another way, which rounds differently, and an object is to get the same bits beside any others.
        weight = points.valid[:, None, :].expand(-1, 2, -1)
        average = (weight @ encoded) / weight.sum(dim=-1, keepdim=True).clamp(min=1.0)
        hidden = torch.relu(self.latent_hidden(average))
        mean, std = self.latent_mean(hidden), 0.1 + 0.9 * torch.sigmoid(self.latent_std(hidden))
        return mean[:, 0], std[:, 0]

    def adapted(self, support: Points, latent: Tensor | None = None) -> Adapted:
        """Learn objects from their supports, with the mean of the prior or another ``latent`` (objects, 128)."""
        entering = self._entering(support)
        encoded = self.support_points(entering)
        keys = Embedded(entering.inputs, self.place)
        memories = tuple(cast(Attention, layer).memory(keys, encoded) for layer in self.cross)
        return Adapted(memories, support.valid, self.latent(support)[0] if latent is None else latent)

    def decode(self, support: Points, inputs: Tensor, latent: Tensor) -> tuple[Tensor, Tensor]:
        """Predict mean and log std (objects, n, outputs) of the outcomes of inputs (objects, n, inputs)."""
        return self.predict(self.adapted(support, latent), inputs)

    def predict(self, known: Adapted, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Predict mean and log std (objects, n, outputs) of the outcomes of inputs (objects, n, inputs)."""
        entering = self._features(inputs)
        found: Tensor | Embedded = Embedded(entering, self.place)
        for layer, memory in zip(self.cross, known.memories, strict=True):
            found = cast(Attention, layer).answer(found, memory, known.valid)
        hidden = torch.relu(self._first_decoder_layer(entering, cast(Tensor, found), known.latent))
        for dense in self.decoder[1:]:
            hidden = torch.relu(dense(hidden))
        # The Gaussian is float32, also where the layers' products are 16-bit.
        with torch.autocast(hidden.device.type, enabled=False):
            out = mixed_last(hidden.flatten(0, 1), self.last.weight, self.last.bias)
            mean, log_std = out.view(*inputs.shape[:-1], -1).chunk(2, dim=-1)
            mean = from_push_frame(mean, inputs) if self.form is PushForm.PUSH_FRAME else mean
        log_std = log_std if self.training else bounded(log_std)
        return mean, log_std if self.least_std == 0.0 else at_least(log_std, self.least_std)

    def _features(self, inputs: Tensor) -> Tensor:
        with torch.autocast(inputs.device.type, enabled=False):
            return features(inputs, self.form)

    def _entering(self, points: Points) -> Points:
        """Return points in the form that the layers take."""
        if self.form is not PushForm.PUSH_FRAME:
            return Points(self._features(points.inputs), points.targets, points.valid)
        with torch.autocast(points.inputs.device.type, enabled=False):
            return Points(self._features(points.inputs), into_push_frame(points.targets, points.inputs), points.valid)

    def _first_decoder_layer(self, inputs: Tensor, found: Tensor, latent: Tensor) -> Tensor:
        """Apply the decoder's first layer to ``[target_input(x), r(x), z]``, each by its own columns, z per object."""
        dense = cast(nn.Linear, self.decoder[0])
        of_input, of_found, of_latent = dense.weight.chunk(3, dim=1)
        same = functional.linear(latent, of_latent, dense.bias) + of_input @ self.target_input.bias
        weight = of_input @ self.target_input.weight
        if self.training:  # one product, and no sum over all pushes beside it
            joined = torch.baddbmm(same[:, None, :], inputs, weight.T.expand(len(inputs), -1, -1))
        else:  # in a graph every push is an object of its own, and shares the weights
            joined = functional.linear(inputs, weight) + same[:, None, :]
        return torch.addmm(joined.flatten(0, 1), found.flatten(0, 1), of_found.T).view_as(joined)

    def forward(self, support: Points, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Predict the outcomes of inputs (objects, n, inputs) with the mean of the prior."""
        return self.predict(self.adapted(support), inputs)
