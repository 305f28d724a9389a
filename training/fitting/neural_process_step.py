"""The neural process in training and evaluation: support and target pushes, evidence bound, gradients, predictions."""

import math
from typing import Final

import torch
from torch import Tensor

from service.model.tensors import ContextKind
from training.fitting.losses import gaussian_divergence, gaussian_nll
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess, Points
from training.networks.push_network import Prediction

SUPPORT_PUSHES: Final = 50
SUPPORT_SHARE: Final = 0.2  # of the pushes of objects that have fewer than Omnipush's 250


def draw_support(samples: Samples, any_count: bool = False) -> tuple[Points, Points]:
    """Draw 50 support pushes of each object from torch's generator. Return support and targets, the remaining pushes.

    Valid pushes come before padding: an object with a single push has it as support and has no target. With
    ``any_count`` some of the 50 stay unseen: each object has 1 to 50, and as often 1 or 2 as 20 to 50.
    """
    rows = samples.valid.shape[1]
    count = min(SUPPORT_PUSHES, max(1, round(SUPPORT_SHARE * rows)))
    order = (torch.rand(samples.valid.shape).to(samples.valid.device) + (1.0 - samples.valid)).argsort(dim=1)
    pick = order[..., None]
    inputs, targets = samples.inputs.take_along_dim(pick, 1), samples.targets.take_along_dim(pick, 1)
    valid = samples.valid.take_along_dim(order, 1)
    seen = valid[:, :count]
    if any_count:
        counts = torch.exp(torch.rand(len(seen), 1) * math.log(count + 1)).to(seen.device)
        seen = seen * (torch.arange(count, device=seen.device) < counts.floor())
    return (
        Points(inputs[:, :count], targets[:, :count], seen),
        Points(inputs[:, count:], targets[:, count:], valid[:, count:]),
    )


def loss_terms(
    network: NeuralProcess, samples: Samples, dtype: torch.dtype, recipe: Recipe | None = None
) -> tuple[Tensor, Tensor]:
    """Return the evidence bound's terms per target value: negative log likelihood and divergence from the prior.

    A process that is to be served meets supports of any count. The paper's, which has no ``recipe``, meets 50 pushes.
    """
    support, targets = draw_support(samples, recipe is not None and recipe.context_kind is ContextKind.SUPPORT)
    with torch.autocast(samples.inputs.device.type, dtype=dtype, enabled=dtype != torch.float32):
        posterior_mean, posterior_std = (value.float() for value in network.latent(targets))
        prior_mean, prior_std = (value.float() for value in network.latent(support))
        drawn = posterior_mean + posterior_std * torch.randn_like(posterior_std)
        mean, log_std = network.decode(support, targets.inputs, drawn)
    values = targets.valid.sum() * targets.targets.shape[-1]
    divergence = gaussian_divergence(posterior_mean, posterior_std, prior_mean, prior_std)
    divergence = (divergence * targets.valid.amax(dim=1)).sum() / values  # zero for objects without a target
    return gaussian_nll(
        mean, log_std, targets.targets, targets.valid, beta=0.0 if recipe is None else recipe.beta
    ), divergence


def set_gradients(
    network: NeuralProcess, samples: Samples, recipe: Recipe, dtype: torch.dtype
) -> tuple[Tensor, Tensor]:
    """Set the gradient of the evidence bound in every parameter. Return its two terms."""
    network.zero_grad()
    likelihood, divergence = loss_terms(network, samples, dtype, recipe)
    torch.autograd.backward(likelihood + divergence)
    return likelihood.detach(), divergence.detach()


def split_pushes(samples: Samples, seed: int, count: int = SUPPORT_PUSHES) -> tuple[Points, Points]:
    """Return support and targets, which depend on the seed alone.

    With a lower ``count``, fewer of the support's pushes are seen. The targets are the same.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        support, targets = draw_support(samples)
    return support.first(count), targets


def predict_targets(
    network: NeuralProcess, samples: Samples, seed: int = 0, leak: bool = False, count: int = SUPPORT_PUSHES
) -> tuple[Prediction, Points]:
    """Predict the targets of a support that depends on the seed alone. Return the Gaussians and the targets.

    ``count`` is that of ``split_pushes``.

    With ``leak`` the latent variable is the posterior's mean, which is computed from the outcomes that are predicted.
    It serves only to show the effect of the leak in the published evaluation.
    """
    support, targets = split_pushes(samples, seed, count)
    latent = network.latent(targets if leak else support)[0]
    return Prediction(*network.decode(support, targets.inputs, latent), None), targets
