"""The Siamese objective against its formulas, written out by hand."""

import math

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from training.losses import gaussian_nll, l2_regulariser

ALL_VALID = torch.ones(2, 3)


def random(*shape: int, seed: int) -> Tensor:
    """Normal numbers, the same for the same seed."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def array_of(tensor: Tensor) -> npt.NDArray[np.float64]:
    """The numbers of a tensor in double precision."""
    array: npt.NDArray[np.float64] = tensor.detach().to(torch.float64).numpy()
    return array


def test_the_likelihood_is_the_normal_density() -> None:
    """It is minus the log of N(target; mean, std), averaged over pushes and outputs."""
    mean, log_std, target = (random(2, 3, 3, seed=seed) for seed in (1, 2, 3))
    std = np.exp(array_of(log_std))
    density = np.exp(-0.5 * ((array_of(target) - array_of(mean)) / std) ** 2) / (std * math.sqrt(2.0 * math.pi))

    found = gaussian_nll(mean, log_std, target, ALL_VALID)
    assert found.item() == pytest.approx(-np.log(density).mean(), rel=1e-5)


def test_a_perfect_guess_of_unit_spread_costs_half_the_log_of_two_pi() -> None:
    """The constant of the density is not left out, so that figures compare with those of other code."""
    zeros = torch.zeros(2, 3, 3)

    assert gaussian_nll(zeros, zeros, zeros, ALL_VALID).item() == pytest.approx(0.9189385, abs=1e-6)


def test_padding_does_not_count() -> None:
    """Neither values nor number of padded rows change the average over the pushes that are there."""
    mean, log_std, target = (random(2, 3, 3, seed=seed) for seed in (1, 2, 3))
    valid = torch.tensor([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    present = valid > 0

    found = gaussian_nll(mean, log_std, target, valid)
    junk = torch.where(present[..., None], target, 1e3)
    expected = gaussian_nll(mean[present][None], log_std[present][None], target[present][None], torch.ones(1, 3))
    assert found.item() == pytest.approx(expected.item(), rel=1e-6)
    assert gaussian_nll(mean, log_std, junk, valid).item() == found.item()


def regulariser_by_hand(mask: Tensor, context: Tensor, pairs: list[tuple[int, int]]) -> float:
    """The paper's context regulariser with lambda_1 = 0.5 and lambda_2 = 3, averaged over these pairs."""
    m, c = array_of(mask), array_of(context)
    terms = [
        0.5 * (math.sqrt(((m[i] - m[j]) ** 2).sum()) - 3.0 * math.sqrt(((c[i] - c[j]) ** 2).sum())) ** 2
        for i, j in pairs
    ]
    return sum(terms) / len(terms)


@pytest.mark.parametrize(
    ("objects", "pairs"),
    [
        pytest.param(2, [(0, 1)], id="two objects"),
        pytest.param(4, [(0, 2), (1, 3)], id="four objects"),
        pytest.param(5, [(0, 2), (1, 3)], id="five: the last has no partner"),
    ],
)
def test_the_regulariser_compares_the_halves_of_a_batch(objects: int, pairs: list[tuple[int, int]]) -> None:
    """Object i of the first half is paired with object i of the second, as in the formula."""
    mask, context = random(objects, 256, seed=4).relu(), random(objects, 36, seed=5).sign()

    found = l2_regulariser(mask, context, lambda_1=0.5, lambda_2=3.0)
    assert found.item() == pytest.approx(regulariser_by_hand(mask, context, pairs), rel=1e-5)


def test_masks_as_far_apart_as_their_contexts_cost_nothing() -> None:
    """The regulariser asks that distances agree, up to lambda_2."""
    context = random(4, 36, seed=6)

    assert l2_regulariser(2.0 * context, context, lambda_1=1.0, lambda_2=2.0).item() == pytest.approx(0.0, abs=1e-10)


def test_a_single_object_has_no_partner() -> None:
    """Its regulariser is zero, not a number that is none."""
    assert l2_regulariser(random(1, 256, seed=7), random(1, 36, seed=8), 0.01, 10.0).item() == 0.0


@pytest.mark.parametrize("same", [False, True], ids=["two masks", "one mask twice"])
def test_gradients_are_finite(same: bool) -> None:
    """Also where a distance is zero and its root has no slope: equal masks of equal objects meet in real batches."""
    mask, context = random(4, 256, seed=9), random(4, 36, seed=10)
    if same:
        mask, context = mask[:1].expand(4, 256).clone(), context[:1].expand(4, 36)
    mean, log_std, mask = random(4, 3, 3, seed=1), random(4, 3, 3, seed=2), mask.requires_grad_()
    for tensor in (mean, log_std):
        tensor.requires_grad_()

    loss = gaussian_nll(mean, log_std, random(4, 3, 3, seed=3), torch.ones(4, 3))
    torch.autograd.backward(loss + l2_regulariser(mask, context, 0.01, 10.0))

    for tensor in (mean, log_std, mask):
        assert tensor.grad is not None
        assert torch.isfinite(tensor.grad).all()
