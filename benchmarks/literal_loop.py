"""Literal implementation of the published training loop, to time beside ours: FCN + CM with the indicator context.

It is written from the behaviour of the paper and the published program, not from their code:

- The batches of a data loader are cut into the two halves of the Siamese pairs. The halves pass the network one after
  the other, each context repeated for every push of its object.
- The distances between the masks of the pairs are computed for every push, and one per object is kept. The distance
  between contexts is learnt by a separate network. Without a regulariser both have weight zero.
- Loss, error, likelihood and spread of every step are recorded.
- After each epoch the test objects pass the network in the same way, with gradients, but without a step.
"""

from collections import defaultdict

import torch
from torch import Tensor, nn
from torch.distributions import Normal
from torch.utils.data import DataLoader, TensorDataset

from training.fitting.evaluation import Evaluation, measure
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples, TrainingData

PUBLISHED_WORKERS = 32  # processes of each of its two data loaders


class LiteralNetwork(nn.Module):
    """Network of FCN + CM with one row of context per push, as the equations are written."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.mask = nn.Linear(3, 256), nn.Linear(36, 256)
        self.second, self.third, self.last = nn.Linear(256, 256), nn.Linear(256, 256), nn.Linear(256, 6)
        self.distance = nn.Sequential(nn.Linear(36, 10), nn.ReLU(), nn.Linear(10, 5))

    def forward(self, pusher: Tensor, context: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return mean, log std and mask of pushes (n, pushes, 3) with contexts (n, 36), and the embedded contexts."""
        repeated = context[:, None, :].repeat(1, pusher.shape[1], 1).reshape(-1, context.shape[-1])
        mask = torch.relu(self.mask(repeated))
        hidden = torch.relu(self.first(pusher.reshape(-1, 3))) * mask
        hidden = torch.relu(self.third(torch.relu(self.second(hidden))))
        mean, log_std = self.last(hidden).chunk(2, dim=-1)
        return mean, log_std, mask, self.distance(context)


class LiteralEpochs:
    """A training loop that runs one epoch at a time."""

    def __init__(self, recipe: Recipe, workers: int, data: TrainingData) -> None:
        """Make the loop. ``workers`` is the number of processes of each data loader; 0 loads in this process."""
        torch.manual_seed(recipe.seed)
        self._recipe = recipe
        self._target_std = data.held_out.target_std
        self._network = LiteralNetwork()
        self._adam = torch.optim.Adam(self._network.parameters(), lr=recipe.learning_rate)
        fork = "fork" if workers else None  # the default on Linux; other start methods take minutes an epoch
        self._train, self._test = (
            DataLoader(
                _as_dataset(samples),
                recipe.batch_objects,
                shuffle=True,
                num_workers=workers,
                multiprocessing_context=fork,
            )
            for samples in (data.train, data.held_out)
        )
        self._record: dict[str, list[float]] = defaultdict(list)
        self._found: list[Tensor] = []

    def step(self) -> None:
        """Train one epoch and pass over the test objects."""
        self._network.train()
        for batch in self._train:
            loss, _ = _step(self._network, batch, self._recipe, self._record)
            self._adam.zero_grad()
            torch.autograd.backward(loss)
            self._adam.step()
        self._network.eval()
        self._found = [_step(self._network, batch, self._recipe, self._record)[1].detach() for batch in self._test]

    def figures(self) -> Evaluation:
        """Return the figures of the test objects after the last epoch."""
        mean, log_std, target = torch.cat(self._found, dim=1).numpy()
        return measure(mean, log_std, target, self._target_std)


def _as_dataset(samples: Samples) -> TensorDataset:
    if not bool((samples.valid > 0).all()):
        raise ValueError("the published loop needs the same number of pushes of every object")
    return TensorDataset(samples.inputs, samples.targets, samples.context)


def _step(
    network: LiteralNetwork, batch: list[Tensor], recipe: Recipe, record: dict[str, list[float]]
) -> tuple[Tensor, Tensor]:
    """Return the loss of a batch, and means, log stds and targets (3, n, 3)."""
    half = len(batch[0]) // 2
    pushes = batch[0].shape[1]
    halves = [[values[:half] for values in batch], [values[half : 2 * half] for values in batch]]
    losses, masks, embedded, found = [], [], [], []
    for pusher, target, context in halves:
        mean, log_std, mask, embedding = network(pusher, context)
        outcome = target.reshape(-1, 3)
        density = Normal(mean, torch.exp(log_std)).log_prob(outcome)  # type: ignore[no-untyped-call]
        losses.append(-density.mean())
        masks.append(mask)
        embedded.append(embedding)
        found.append(torch.stack([mean, log_std, outcome]))
    gaussians = torch.cat(found, dim=1)
    likelihood = (losses[0] + losses[1]) / 2.0
    mask_distance = torch.sqrt(((masks[0] - masks[1]) ** 2).sum(dim=1) + 1e-12)[::pushes]
    difference = mask_distance - recipe.lambda_2 * (embedded[0] * embedded[1]).sum(dim=1)
    loss = likelihood + 0.0 * (difference**2).mean()
    mean, log_std, outcome = gaussians
    record["loss"].append(loss.item())
    record["rmse"].append(torch.sqrt(((mean - outcome) ** 2).mean()).item())
    record["likelihood"].append(likelihood.item())
    record["log_std"].append(log_std.mean().item())
    return loss, gaussians
