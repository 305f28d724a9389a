"""Losses: the paper's Siamese objective (section III), Gaussian likelihood plus context regulariser, and divergence."""

import math
from collections.abc import Callable

import torch
from torch import Tensor


def gaussian_nll(
    mean: Tensor, log_std: Tensor, target: Tensor, valid: Tensor, pushes: Tensor | None = None, beta: float = 0.0
) -> Tensor:
    """Return the negative log likelihood, averaged over all valid pushes and their outputs.

    ``mean``, ``log_std`` and ``target`` are (objects, pushes, outputs), ``valid`` is (objects, pushes): one or zero.
    For a shard of a batch, ``pushes`` is the number of valid pushes in the whole batch: shards add up to the average.

    With ``beta`` each term is weighted by its std to the power 2 beta, as a constant (beta-NLL, Seitzer et al., 2022).
    Pushes that can be predicted exactly, such as misses, then do not drown the others.
    """
    scaled = (target - mean) * torch.exp(-log_std)
    per_output = 0.5 * scaled * scaled + log_std + 0.5 * math.log(2.0 * math.pi)
    if beta > 0.0:
        per_output = per_output * torch.exp(2.0 * beta * log_std.detach())
    pushes = valid.sum() if pushes is None else pushes
    return (per_output * valid[..., None]).sum() / (pushes * target.shape[-1])


def context_regulariser(
    mask: Tensor, context: Tensor, distance: Callable[[Tensor, Tensor], Tensor], lambda_1: float, lambda_2: float
) -> Tensor:
    """Return ``lambda_1 (|m(c) - m(c')| - lambda_2 d(c, c'))^2``, averaged over the Siamese pairs of a batch.

    The batch is cut into two halves. Object i of the first half is paired with object i of the second. In an odd batch
    the last object has no partner and is left out.
    """
    half = len(mask) // 2
    if half == 0:
        return mask.new_zeros(())
    mask_distance = torch.linalg.vector_norm(mask[:half] - mask[half : 2 * half], dim=-1)
    difference: Tensor = mask_distance - lambda_2 * distance(context[:half], context[half : 2 * half])
    return lambda_1 * difference.square().mean()


def gaussian_divergence(mean: Tensor, std: Tensor, prior_mean: Tensor, prior_std: Tensor) -> Tensor:
    """Return the Kullback-Leibler divergence of independent Gaussians from a prior, summed over the last axis."""
    ratio = std / prior_std
    shift = (mean - prior_mean) / prior_std
    return (0.5 * (ratio * ratio + shift * shift - 1.0) - torch.log(ratio)).sum(dim=-1)
