"""The neural process in training and evaluation: support and target pushes, evidence bound, gradients, predictions."""

from typing import Final

import torch
from torch import Tensor

from training.fitting.losses import gaussian_divergence, gaussian_nll
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess, Points
from training.networks.push_network import Prediction

SUPPORT_PUSHES: Final = 50
SUPPORT_SHARE: Final = 0.2  # of the pushes of objects that have fewer than Omnipush's 250


def draw_support(samples: Samples) -> tuple[Points, Points]:
    """Draw 50 support pushes of each object from torch's generator. Return support and targets, the remaining pushes.

    Valid pushes come before padding: an object with a single push has it as support and has no target.
    """
    rows = samples.valid.shape[1]
    count = min(SUPPORT_PUSHES, max(1, round(SUPPORT_SHARE * rows)))
    order = (torch.rand(samples.valid.shape).to(samples.valid.device) + (1.0 - samples.valid)).argsort(dim=1)
    pick = order[..., None]
    inputs, targets = samples.inputs.take_along_dim(pick, 1), samples.targets.take_along_dim(pick, 1)
    valid = samples.valid.take_along_dim(order, 1)
    return (
        Points(inputs[:, :count], targets[:, :count], valid[:, :count]),
        Points(inputs[:, count:], targets[:, count:], valid[:, count:]),
    )


def loss_terms(network: NeuralProcess, samples: Samples, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Return the evidence bound's terms per target value: negative log likelihood and divergence from the prior."""
    support, targets = draw_support(samples)
    with torch.autocast(samples.inputs.device.type, dtype=dtype, enabled=dtype != torch.float32):
        posterior_mean, posterior_std = (value.float() for value in network.latent(targets))
        prior_mean, prior_std = (value.float() for value in network.latent(support))
        drawn = posterior_mean + posterior_std * torch.randn_like(posterior_std)
        mean, log_std = network.decode(support, targets.inputs, drawn)
    values = targets.valid.sum() * targets.targets.shape[-1]
    divergence = gaussian_divergence(posterior_mean, posterior_std, prior_mean, prior_std)
    divergence = (divergence * targets.valid.amax(dim=1)).sum() / values  # zero for objects without a target
    return gaussian_nll(mean, log_std, targets.targets, targets.valid), divergence


def set_gradients(network: NeuralProcess, samples: Samples, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Set the gradient of the evidence bound in every parameter. Return its two terms."""
    network.zero_grad()
    likelihood, divergence = loss_terms(network, samples, dtype)
    torch.autograd.backward(likelihood + divergence)
    return likelihood.detach(), divergence.detach()


def predict_targets(
    network: NeuralProcess, samples: Samples, seed: int = 0, leak: bool = False
) -> tuple[Prediction, Points]:
    """Predict the targets of a support that depends on the seed alone. Return the Gaussians and the targets.

    With ``leak`` the latent variable is the posterior's mean, which is computed from the outcomes that are predicted.
    It serves only to show the effect of the leak in the published evaluation.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        support, targets = draw_support(samples)
    latent = network.latent(targets if leak else support)[0]
    return Prediction(*network.decode(support, targets.inputs, latent), None), targets
