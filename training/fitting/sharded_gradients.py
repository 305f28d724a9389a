"""The gradient of a step by shards of its objects, each on one core.

A batch is cut the same way on every machine, each shard is worked through by one thread, and shares are added in order:
so the gradient is the same to the bit on one core and on many, and what a layer gives is still near its core when the
next one takes it. Torch's own threads share every single product instead: they wait for each other some forty times a
step, and long where another program has one of their cores.
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
LEAST_SAMPLES: Final = 500  # of a shard: with fewer, calls take longer than products


@dataclass(frozen=True)
class Share:
    """What the objects of a shard add to a step."""

    likelihood: Tensor
    layers: tuple[Tensor, ...]  # gradients of the parameters that meet every push
    conditioning: tuple[Tensor, ...]  # gradient of what their contexts do, if they have any


Mapper = Callable[[Callable[[slice], Share], Iterable[slice]], Iterable[Share]]  # as Python's map


@contextmanager
def cores() -> Iterator[Mapper]:
    """A ``map`` over as many threads as torch was given; meanwhile torch itself has one in each of them."""
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
    """The objects of each shard, which depend on the batch alone; one for a GPU, which shares work by itself."""
    objects, samples = batch.valid.shape
    count = 1 if batch.inputs.is_cuda else min(MOST_SHARDS, objects, max(1, objects * samples // LEAST_SAMPLES))
    return [slice(*ends) for ends in pairwise(objects * number // count for number in range(count + 1))]


def set_gradients(
    network: PushNetwork, batch: Samples, recipe: Recipe, dtype: torch.dtype, run: Mapper = map
) -> tuple[Tensor, Tensor]:
    """Set the gradient of the loss in every parameter; the two terms of the loss, likelihood and regulariser.

    Contexts are encoded for the whole batch: the regulariser compares its pairs, and batch norm takes its mean.
    """
    network.zero_grad()
    conditioning = network.conditioning(batch.context)
    layers = network.push_parameters()
    samples = batch.valid.sum()

    def share(objects: slice) -> Share:
        """Forth and back through the layers that meet every push."""
        given = [] if conditioning is None else [conditioning.detach()[objects].requires_grad_()]
        mean, log_std = network.conditioned(batch.inputs[objects], given[0] if given else None, dtype)
        likelihood = gaussian_nll(mean, log_std, batch.targets[objects], batch.valid[objects], samples)
        found = torch.autograd.grad(likelihood, [*layers, *given])
        return Share(likelihood.detach(), found[: len(layers)], found[len(layers) :])

    shards = shards_of(batch)
    shares = list(run(share, shards) if len(shards) > 1 else map(share, shards))
    for parameter, *gradients in zip(layers, *(found.layers for found in shares), strict=True):
        parameter.grad = torch.stack(gradients).sum(dim=0)
    likelihood, penalty = torch.stack([found.likelihood for found in shares]).sum(), samples.new_zeros(())
    if conditioning is not None:
        if network.distance is not None:
            penalty = context_regulariser(
                conditioning, batch.context, network.distance, recipe.lambda_1, recipe.lambda_2
            )
        slopes = torch.cat([found.conditioning[0] for found in shares])
        torch.autograd.backward((conditioning * slopes).sum() + penalty)  # whose gradient there is the slopes
    return likelihood, penalty.detach()
