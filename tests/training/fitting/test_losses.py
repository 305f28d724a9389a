"""Losses: the Siamese objective and the divergence against their formulas, written out by hand."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.training import reference_equations
from tests.training.reference_equations import array_of
from training.fitting.losses import context_regulariser, gaussian_divergence, gaussian_nll
from training.networks.encoders import EuclideanDistance, KernelDistance

ALL_VALID = torch.ones(2, 3)


def normals(*shape: int, seed: int) -> Tensor:
    """Draw normal numbers, the same for the same seed."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_the_likelihood_is_the_normal_density() -> None:
    """The likelihood loss is minus the log of N(target | mean, std), averaged over pushes and outputs."""
    mean, log_std, target = (normals(2, 3, 3, seed=seed) for seed in (1, 2, 3))
    std = np.exp(array_of(log_std))
    density = np.exp(-0.5 * ((array_of(target) - array_of(mean)) / std) ** 2) / (std * math.sqrt(2.0 * math.pi))

    found = gaussian_nll(mean, log_std, target, ALL_VALID)
    assert found.item() == pytest.approx(-np.log(density).mean(), rel=1e-5)


def test_a_perfect_guess_of_unit_spread_costs_half_the_log_of_two_pi() -> None:
    """The density's constant, 0.5 log(2 pi), is part of the loss, so that figures compare with those of other code."""
    zeros = torch.zeros(2, 3, 3)

    assert gaussian_nll(zeros, zeros, zeros, ALL_VALID).item() == pytest.approx(0.9189385, abs=1e-6)


def test_padding_does_not_count() -> None:
    """Neither values nor number of padded rows change the average over valid pushes."""
    mean, log_std, target = (normals(2, 3, 3, seed=seed) for seed in (1, 2, 3))
    valid = torch.tensor([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    present = valid > 0

    found = gaussian_nll(mean, log_std, target, valid)
    junk = torch.where(present[..., None], target, 1e3)
    expected = gaussian_nll(mean[present][None], log_std[present][None], target[present][None], torch.ones(1, 3))
    assert found.item() == pytest.approx(expected.item(), rel=1e-6)
    assert gaussian_nll(mean, log_std, junk, valid).item() == found.item()


def contexts(kind: str, objects: int) -> Tensor:
    """Draw context vectors or images."""
    shape = (objects, 36) if kind == "indicator" else (objects, 1, 32, 32)
    return normals(*shape, seed=5).sigmoid()


PAIRS = [
    pytest.param(2, [(0, 1)], id="two objects"),
    pytest.param(4, [(0, 2), (1, 3)], id="four objects"),
    pytest.param(5, [(0, 2), (1, 3)], id="five: the last has no partner"),
]


@pytest.mark.parametrize("kind", ["indicator", "visual"])
@pytest.mark.parametrize(("objects", "pairs"), PAIRS)
def test_the_l2_regulariser_compares_the_halves_of_a_batch(
    kind: str, objects: int, pairs: list[tuple[int, int]]
) -> None:
    """The L2 regulariser pairs object i of the first half with object i of the second, contexts vectorised."""
    mask, context = normals(objects, 256, seed=4).relu(), contexts(kind, objects)
    m, c = array_of(mask), array_of(context).reshape(objects, -1)
    terms = [
        0.5 * (math.sqrt(((m[i] - m[j]) ** 2).sum()) - 3.0 * math.sqrt(((c[i] - c[j]) ** 2).sum())) ** 2
        for i, j in pairs
    ]

    found = context_regulariser(mask, context, EuclideanDistance(), lambda_1=0.5, lambda_2=3.0)
    assert found.item() == pytest.approx(sum(terms) / len(terms), rel=1e-5)


@pytest.mark.parametrize("kind", ["indicator", "visual"])
@pytest.mark.parametrize(("objects", "pairs"), PAIRS)
def test_the_neural_regulariser_is_the_paper_s(kind: str, objects: int, pairs: list[tuple[int, int]]) -> None:
    """The neural regulariser takes the inner product of the embeddings as distance."""
    mask, context = normals(objects, 256, seed=4).relu(), contexts(kind, objects)
    torch.manual_seed(6)
    distance = KernelDistance(tuple(context.shape[1:]))
    weights = {f"distance.{name}": value for name, value in distance.state_dict().items()}
    embedded = reference_equations.phi(weights, array_of(context))
    products = np.array([embedded[i] @ embedded[j] for i, j in pairs])

    found = context_regulariser(mask, context, distance, lambda_1=0.5, lambda_2=1.0)
    assert found.item() == pytest.approx(reference_equations.regulariser(array_of(mask), products, 0.5, 1.0), rel=1e-5)


def test_the_neural_regulariser_trains_mask_and_embedding() -> None:
    """The neural regulariser has non-zero gradients for the mask and for the weights of the embedding."""
    mask, context = normals(4, 256, seed=4).relu().requires_grad_(), contexts("indicator", 4)
    distance = KernelDistance((36,))

    torch.autograd.backward(context_regulariser(mask, context, distance, 0.01, 1.0))

    for tensor in (mask, *distance.parameters()):
        assert tensor.grad is not None
        assert tensor.grad.abs().max() > 0.0


def test_masks_as_far_apart_as_their_contexts_have_no_loss() -> None:
    """The regulariser is zero where mask distances are lambda_2 times the context distances."""
    context = normals(4, 36, seed=6)

    found = context_regulariser(2.0 * context, context, EuclideanDistance(), lambda_1=1.0, lambda_2=2.0)
    assert found.item() == pytest.approx(0.0, abs=1e-10)


def test_a_single_object_has_no_partner() -> None:
    """The regulariser of a batch with a single object is zero."""
    assert (
        context_regulariser(normals(1, 256, seed=7), normals(1, 36, seed=8), EuclideanDistance(), 1.0, 1.0).item() == 0
    )


@pytest.mark.parametrize("same", [False, True], ids=["two masks", "one mask twice"])
def test_gradients_are_finite(same: bool) -> None:
    """Gradients are finite even at distance zero: equal masks of equal objects occur in real batches."""
    mask, context = normals(4, 256, seed=9), normals(4, 36, seed=10)
    if same:
        mask, context = mask[:1].expand(4, 256).clone(), context[:1].expand(4, 36)
    mean, log_std, mask = normals(4, 3, 3, seed=1), normals(4, 3, 3, seed=2), mask.requires_grad_()
    for tensor in (mean, log_std):
        tensor.requires_grad_()

    loss = gaussian_nll(mean, log_std, normals(4, 3, 3, seed=3), torch.ones(4, 3))
    torch.autograd.backward(loss + context_regulariser(mask, context, EuclideanDistance(), 0.01, 10.0))

    for tensor in (mean, log_std, mask):
        assert tensor.grad is not None
        assert torch.isfinite(tensor.grad).all()


def test_a_divergence_is_the_integral_that_defines_it() -> None:
    """The divergence KL(q, p) is the mean of log q - log p under q, compared with a fine sum per axis."""
    z = np.linspace(-30.0, 30.0, 200_001)
    expected = 0.0
    for mean, std, prior_mean, prior_std in ((0.3, 0.5, -0.2, 0.9), (-1.0, 1.5, 0.4, 0.6)):
        log_q, log_p = (
            -0.5 * ((z - m) / s) ** 2 - math.log(s * math.sqrt(2.0 * math.pi))
            for m, s in ((mean, std), (prior_mean, prior_std))
        )
        expected += float((np.exp(log_q) * (log_q - log_p)).sum() * (z[1] - z[0]))

    found = gaussian_divergence(
        torch.tensor([[0.3, -1.0]]), torch.tensor([[0.5, 1.5]]), torch.tensor([[-0.2, 0.4]]), torch.tensor([[0.9, 0.6]])
    )
    assert found.tolist() == pytest.approx([expected], rel=1e-5)


def test_a_gaussian_does_not_diverge_from_itself() -> None:
    """The divergence of a Gaussian from itself is zero."""
    mean, std = normals(3, 128, seed=1), normals(3, 128, seed=2).exp()

    assert gaussian_divergence(mean, std, mean, std).tolist() == pytest.approx([0.0] * 3, abs=1e-4)


def test_beta_weights_each_term_by_its_std_without_a_gradient_of_its_own() -> None:
    """With beta 0.5 each term is its likelihood times its std, and the weight counts as a constant."""
    mean, log_std, target = (normals(2, 3, 3, seed=seed) for seed in (1, 2, 3))
    log_std.requires_grad_()
    weight = torch.exp(log_std.detach())
    terms = 0.5 * ((target - mean) * torch.exp(-log_std)) ** 2 + log_std + 0.5 * math.log(2.0 * math.pi)

    found = gaussian_nll(mean, log_std, target, ALL_VALID, beta=0.5)
    (slope,) = torch.autograd.grad(found, [log_std])
    (expected,) = torch.autograd.grad((weight * terms).mean(), [log_std])
    assert torch.allclose(slope, expected, atol=1e-6)
    assert found.item() == pytest.approx((weight * terms).mean().item(), rel=1e-5)
