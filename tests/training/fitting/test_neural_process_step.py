"""The neural process in training: its support, its evidence bound, padding, and the effect of leaked targets."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.training import reference_equations
from tests.training.networks.fixed_process import fixed_process
from tests.training.reference_equations import array_of
from training.fitting.evaluation import evaluate
from training.fitting.neural_process_step import draw_support, loss_terms, predict_targets, split_pushes
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples


def random_samples(objects: int = 3, pushes: int = 20, seed: int = 1) -> Samples:
    """Draw normal numbers for pushes, all of them valid."""
    generator = torch.Generator().manual_seed(seed)
    inputs, targets = torch.randn(2, objects, pushes, 3, generator=generator)
    return Samples(inputs, targets, torch.ones(objects, pushes), torch.zeros(objects, 0), (1.0, 1.0, 1.0))


def test_the_loss_is_the_evidence_bound_per_target_value() -> None:
    """Without dropout, likelihood and divergence agree with the bound's equations written out in numpy."""
    network, samples = fixed_process(), random_samples()
    with torch.no_grad():
        torch.manual_seed(8)
        nll, divergence = loss_terms(network, samples, torch.float32)
        torch.manual_seed(8)
        support, targets = draw_support(samples)
        noise = array_of(torch.randn(3, 128))

    weights, nll_sum, divergence_sum = network.state_dict(), 0.0, 0.0
    for row in range(3):
        s_x, s_y, t_x, t_y = (
            array_of(value[row]) for value in (support.inputs, support.targets, targets.inputs, targets.targets)
        )
        (mean, std), (prior_mean, prior_std) = (
            reference_equations.latent(weights, t_x, t_y),
            reference_equations.latent(weights, s_x, s_y),
        )
        found, log_std = reference_equations.neural_process(weights, s_x, s_y, t_x, mean + std * noise[row])
        nll_sum += (0.5 * ((t_y - found) / np.exp(log_std)) ** 2 + log_std + 0.5 * np.log(2.0 * np.pi)).sum()
        shift = (mean - prior_mean) / prior_std
        divergence_sum += (np.log(prior_std / std) + 0.5 * ((std / prior_std) ** 2 + shift**2 - 1.0)).sum()
    values = 3 * targets.inputs.shape[1] * 3
    assert nll.item() == pytest.approx(nll_sum / values, rel=1e-3)
    assert divergence.item() == pytest.approx(divergence_sum / values, rel=1e-3)


def test_fifty_of_omnipush_s_pushes_are_support() -> None:
    """Of 250 pushes 50 are support. Support and targets share no push and miss none, and other draws differ."""
    samples = random_samples(objects=2, pushes=250)
    torch.manual_seed(1)
    support, targets = draw_support(samples)
    other, _ = draw_support(samples)

    assert (support.inputs.shape, targets.inputs.shape) == ((2, 50, 3), (2, 200, 3))
    together = torch.cat([support.inputs, targets.inputs], dim=1)
    assert torch.equal(together[0].sort(dim=0).values, samples.inputs[0].sort(dim=0).values)
    assert not torch.equal(support.inputs, other.inputs)
    assert not torch.equal(support.inputs[0, :, 0].argsort(), support.inputs[1, :, 0].argsort())


def test_a_process_that_is_served_meets_supports_of_any_count() -> None:
    """Counts lie between 1 and 50, small ones as often as large ones by their ratio, and targets are the same."""
    samples = random_samples(objects=400, pushes=60)
    torch.manual_seed(1)
    support, targets = draw_support(samples, any_count=True)
    torch.manual_seed(1)
    _, expected = draw_support(samples)
    counts = support.valid.sum(dim=1)

    assert torch.equal(targets.inputs, expected.inputs)
    assert (counts.min().item(), counts.max().item()) == (1.0, 12.0)
    assert 0.2 < (counts == 1.0).float().mean() < 0.35  # log 2 over log 13 is 0.27
    assert torch.equal(support.valid, support.valid.sort(dim=1, descending=True).values)


def test_a_smaller_support_is_the_first_part_of_a_larger_one() -> None:
    """The pushes of a support of 3 are among those of 10, and the targets are the same for both."""
    samples = random_samples(objects=2, pushes=100)
    (three, targets), (ten, others) = (split_pushes(samples, 4, count) for count in (3, 10))

    assert torch.equal(three.inputs, ten.inputs[:, :3])
    assert torch.equal(targets.targets, others.targets)
    assert targets.inputs.shape[1] == 80


def test_the_recipe_of_a_served_process_weighs_its_likelihood(recipe: Recipe) -> None:
    """Beta and supports of any count change the loss, and the paper's process is trained as without a recipe."""
    network, samples = fixed_process(), random_samples()
    losses = []
    for given in (None, recipe, replace(recipe, beta=0.5), replace(recipe, context="support")):
        torch.manual_seed(8)
        with torch.no_grad():
            losses.append(loss_terms(network, samples, torch.float32, given)[0].item())

    assert losses[0] == losses[1]
    assert len({round(loss, 6) for loss in losses}) == 3


def with_padding(samples: Samples, junk: float) -> Samples:
    """Pad the last object after four pushes with ``junk``."""
    valid = samples.valid.clone()
    valid[-1, 4:] = 0.0
    empty = valid[..., None] == 0.0
    return replace(
        samples,
        inputs=samples.inputs.masked_fill(empty, junk),
        targets=samples.targets.masked_fill(empty, junk),
        valid=valid,
    )


def test_padding_is_neither_support_nor_target() -> None:
    """Values in padding change neither losses nor measures."""
    network = fixed_process()
    losses, measures = [], []
    for junk in (0.0, 30.0):
        samples = with_padding(random_samples(), junk)
        with torch.no_grad():
            torch.manual_seed(8)
            losses.append([term.item() for term in loss_terms(network, samples, torch.float32)])
        measures.append(evaluate(network, samples))

    assert np.isfinite(losses[0]).all()
    assert losses[0] == pytest.approx(losses[1], rel=1e-5)
    assert measures[0].rmse == pytest.approx(measures[1].rmse, rel=1e-5)


def test_an_object_with_a_single_push_is_no_target() -> None:
    """An object with a single push has it as support, adds no loss, and leaves all gradients finite."""
    samples = random_samples(objects=2)
    valid = samples.valid.clone()
    valid[1, 1:] = 0.0
    samples = replace(samples, valid=valid)
    network = fixed_process()
    torch.manual_seed(8)
    nll, divergence = loss_terms(network, samples, torch.float32)
    torch.autograd.backward(nll + divergence)

    assert all(p.grad is None or torch.isfinite(p.grad).all() for p in network.parameters())
    assert evaluate(network, samples).rmse > 0.0


def test_predictions_from_the_prior_ignore_the_outcomes() -> None:
    """Other outcomes of the targets change the predictions with the leak only."""
    network, samples = fixed_process(), random_samples()
    _, targets = predict_targets(network, samples)
    is_target = (samples.inputs[:, :, None, 0] == targets.inputs[:, None, :, 0]).any(dim=2)
    other = replace(samples, targets=torch.where(is_target[..., None], -samples.targets, samples.targets))
    with torch.no_grad():
        from_prior = [predict_targets(network, given)[0].mean for given in (samples, other)]
        from_leak = [predict_targets(network, given, leak=True)[0].mean for given in (samples, other)]

    assert torch.equal(from_prior[0], from_prior[1])
    assert not torch.allclose(from_leak[0], from_leak[1], atol=1e-3)


def test_measuring_draws_the_same_support_and_disturbs_no_generator() -> None:
    """Evaluating twice gives the same figures, and leaves the state of torch's generator."""
    network, samples = fixed_process().train(), random_samples()
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first = evaluate(network, samples)

    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(6)
    assert evaluate(network, samples) == first
    assert network.training


def test_bfloat16_products_leave_float32_losses() -> None:
    """With bfloat16 products the losses differ by less than 5 %, and losses and gradients stay float32."""
    network, samples = fixed_process(), random_samples()
    terms = []
    for dtype in (torch.float32, torch.bfloat16):
        torch.manual_seed(8)
        terms.append(loss_terms(network, samples, dtype))
    torch.autograd.backward(terms[1])

    assert {term.dtype for term in terms[1]} == {torch.float32}
    assert terms[1][0].item() == pytest.approx(terms[0][0].item(), rel=0.05)
    assert network.last.weight.grad is not None
    assert network.last.weight.grad.dtype is torch.float32
