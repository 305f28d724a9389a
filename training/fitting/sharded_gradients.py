"""The gradient of a training step, computed in shards of the batch's objects, each shard on one core.

A batch is cut the same way on every machine. One thread works through each shard, and the shards' gradients are added
in order. The gradient is therefore the same to the bit on any number of cores, and a layer's output is still in the
core's cache when the next layer reads it. Torch's own threads share every single product instead: they wait for each
other about forty times per step, and for long where another program occupies a core.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import torch
from torch import Tensor

from training.fitting.losses import context_regulariser, gaussian_nll
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples
from training.networks.push_network import PushNetwork

MOST_SHARDS: Final = 4
LEAST_SAMPLES: Final = 500  # per shard: below it, calls take longer than products


@dataclass(frozen=True)
class ShardGradients:
    """Likelihood and gradients that the objects of one shard add to a step."""

    likelihood: Tensor
    layers: tuple[Tensor, ...]  # gradients of ``PushNetwork.push_parameters``
    conditioning: tuple[Tensor, ...]  # gradient with respect to the objects' conditioning, empty without context


ShardMap = Callable[[Callable[[slice], ShardGradients], Iterable[slice]], Iterable[ShardGradients]]  # like map()


@contextmanager
def thread_pool() -> Iterator[ShardMap]:
    """Provide a ``map`` over as many threads as torch has. Meanwhile torch uses one thread in each of them."""
    threads = torch.get_num_threads()
    if threads == 1:
        yield map
        return
    torch.set_num_threads(1)
    try:
        with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield pool.map
    finally:
        torch.set_num_threads(threads)


def shards_of(batch: Samples) -> list[slice]:
    """Return the objects of each shard. They depend on the batch alone. A GPU gets a single shard."""
    objects, samples = batch.valid.shape
    count = 1 if batch.inputs.is_cuda else min(MOST_SHARDS, objects, max(1, objects * samples // LEAST_SAMPLES))
    return [slice(*ends) for ends in pairwise(objects * number // count for number in range(count + 1))]


def set_gradients(
    network: PushNetwork, batch: Samples, recipe: Recipe, dtype: torch.dtype, shard_map: ShardMap = map
) -> tuple[Tensor, Tensor]:
    """Set the gradient of the loss in every parameter. Return the loss's two terms, likelihood and regulariser.

    Contexts are encoded for the whole batch: the regulariser compares its pairs, and batch norm takes its mean.
    """
    network.zero_grad()
    conditioning = network.conditioning(batch.context)
    layers = network.push_parameters()
    samples = batch.valid.sum()

    def shard_gradients(objects: slice) -> ShardGradients:
        """Run a shard forward and backward through the layers that take every push."""
        given = [] if conditioning is None else [conditioning.detach()[objects].requires_grad_()]
        mean, log_std = network.conditioned(batch.inputs[objects], given[0] if given else None, dtype)
        likelihood = gaussian_nll(mean, log_std, batch.targets[objects], batch.valid[objects], samples, recipe.beta)
        gradients = torch.autograd.grad(likelihood, [*layers, *given])
        return ShardGradients(likelihood.detach(), gradients[: len(layers)], gradients[len(layers) :])

    shards = shards_of(batch)
    found = list(shard_map(shard_gradients, shards) if len(shards) > 1 else map(shard_gradients, shards))
    for parameter, *gradients in zip(layers, *(shard.layers for shard in found), strict=True):
        parameter.grad = torch.stack(gradients).sum(dim=0)
    likelihood, penalty = torch.stack([shard.likelihood for shard in found]).sum(), samples.new_zeros(())
    if conditioning is not None:
        if network.distance is not None:
            penalty = context_regulariser(
                conditioning, batch.context, network.distance, recipe.lambda_1, recipe.lambda_2
            )
        slopes = torch.cat([shard.conditioning[0] for shard in found])
        torch.autograd.backward((conditioning * slopes).sum() + penalty)  # the product's gradient is the slopes
    return likelihood, penalty.detach()
