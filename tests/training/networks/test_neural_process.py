"""The attentive neural process: its size, its equations, what it may see, and what a leak of the targets does."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.training import by_hand
from tests.training.by_hand import array_of
from training.fitting.evaluation import evaluate
from training.fitting.neural_process_step import divide, loss_terms, predict_targets
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess, Points

# query, key, value, mixture (128 + 1) 128 each, and scale and shift of the norm
ATTENTION = 4 * 129 * 128 + 2 * 128
# (6 + 1) 128 and two layers
POINT_ENCODER = 7 * 128 + 2 * ATTENTION


def process() -> NeuralProcess:
    """A process with known random weights, larger than fresh ones so that every term counts, as if it were fitted."""
    torch.manual_seed(21)
    network = NeuralProcess()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.mul_(1.5)
    return network.eval()


def some_samples(objects: int = 3, pushes: int = 20, seed: int = 1) -> Samples:
    """Normal numbers for pushes, all of them valid."""
    generator = torch.Generator().manual_seed(seed)
    inputs, targets = torch.randn(2, objects, pushes, 3, generator=generator)
    return Samples(inputs, targets, torch.ones(objects, pushes), torch.zeros(objects, 0), (1.0, 1.0, 1.0))


def points_of(samples: Samples, rows: slice) -> Points:
    """Some pushes of every object."""
    return Points(samples.inputs[:, rows], samples.targets[:, rows], samples.valid[:, rows])


def test_the_process_has_the_size_of_its_equations() -> None:
    """Two point encoders, a latent head of three layers, keys, cross-attention, and a decoder three times 384 wide."""
    latent_head, place = 3 * 129 * 128, 4 * 128
    decoder = place + 3 * 385 * 384 + 385 * 6
    expected = 2 * POINT_ENCODER + latent_head + place + 2 * ATTENTION + decoder

    assert sum(parameter.numel() for parameter in process().parameters()) == expected == 896_006


def test_a_forward_pass_is_the_equations() -> None:
    """Latent mean and std, and the Gaussian of each target, agree with the equations written out in numpy."""
    network, samples = process(), some_samples()
    support, targets = points_of(samples, slice(0, 6)), points_of(samples, slice(6, 20))
    with torch.no_grad():
        prior_mean, prior_std = network.latent(support)
        mean, log_std = network(support, targets.inputs)

    weights = network.state_dict()
    for row in range(3):
        s_inputs, s_targets, inputs = (
            array_of(value[row]) for value in (support.inputs, support.targets, targets.inputs)
        )
        z, std = by_hand.latent(weights, s_inputs, s_targets)
        expected = by_hand.neural_process(weights, s_inputs, s_targets, inputs, z)
        assert array_of(prior_mean[row]) == pytest.approx(z, abs=1e-4)
        assert array_of(prior_std[row]) == pytest.approx(std, abs=1e-5)
        assert array_of(mean[row]) == pytest.approx(expected[0], abs=1e-3)
        assert array_of(log_std[row]) == pytest.approx(expected[1], abs=1e-3)


def test_the_loss_is_the_evidence_bound_per_target_value() -> None:
    """Without dropout: likelihood under a draw of the posterior, and its divergence from the prior, by hand."""
    network, samples = process(), some_samples()
    with torch.no_grad():
        torch.manual_seed(8)
        nll, divergence = loss_terms(network, samples, torch.float32)
        torch.manual_seed(8)
        support, targets = divide(samples)
        noise = array_of(torch.randn(3, 128))

    weights, nll_sum, divergence_sum = network.state_dict(), 0.0, 0.0
    for row in range(3):
        s_x, s_y, t_x, t_y = (
            array_of(value[row]) for value in (support.inputs, support.targets, targets.inputs, targets.targets)
        )
        (mean, std), (prior_mean, prior_std) = by_hand.latent(weights, t_x, t_y), by_hand.latent(weights, s_x, s_y)
        found, log_std = by_hand.neural_process(weights, s_x, s_y, t_x, mean + std * noise[row])
        nll_sum += (0.5 * ((t_y - found) / np.exp(log_std)) ** 2 + log_std + 0.5 * np.log(2.0 * np.pi)).sum()
        shift = (mean - prior_mean) / prior_std
        divergence_sum += (np.log(prior_std / std) + 0.5 * ((std / prior_std) ** 2 + shift**2 - 1.0)).sum()
    values = 3 * targets.inputs.shape[1] * 3
    assert nll.item() == pytest.approx(nll_sum / values, rel=1e-3)
    assert divergence.item() == pytest.approx(divergence_sum / values, rel=1e-3)


def test_fifty_of_omnipush_s_pushes_are_support() -> None:
    """Support and targets share no push and miss none; another seed draws others."""
    samples = some_samples(objects=2, pushes=250)
    torch.manual_seed(1)
    support, targets = divide(samples)
    other, _ = divide(samples)

    assert (support.inputs.shape, targets.inputs.shape) == ((2, 50, 3), (2, 200, 3))
    together = torch.cat([support.inputs, targets.inputs], dim=1)
    assert torch.equal(together[0].sort(dim=0).values, samples.inputs[0].sort(dim=0).values)
    assert not torch.equal(support.inputs, other.inputs)
    assert not torch.equal(support.inputs[0, :, 0].argsort(), support.inputs[1, :, 0].argsort())


def with_padding(samples: Samples, junk: float) -> Samples:
    """The last object has four pushes only, the others have all; whatever stands in the padding."""
    valid = samples.valid.clone()
    valid[-1, 4:] = 0.0
    empty = valid[..., None] == 0.0
    return replace(
        samples,
        inputs=samples.inputs.masked_fill(empty, junk),
        targets=samples.targets.masked_fill(empty, junk),
        valid=valid,
    )


def test_padding_teaches_and_tells_nothing() -> None:
    """It is neither support nor target: whatever stands there, loss and measures are the same, and finite."""
    network = process()
    losses, measures = [], []
    for junk in (0.0, 30.0):
        samples = with_padding(some_samples(), junk)
        with torch.no_grad():
            torch.manual_seed(8)
            losses.append([term.item() for term in loss_terms(network, samples, torch.float32)])
        measures.append(evaluate(network, samples))

    assert np.isfinite(losses[0]).all()
    assert losses[0] == pytest.approx(losses[1], rel=1e-5)
    assert measures[0].rmse == pytest.approx(measures[1].rmse, rel=1e-5)


def test_an_object_with_a_single_push_is_no_target() -> None:
    """Its only push is its support; it has no share in the loss, and makes nothing NaN."""
    samples = some_samples(objects=2)
    valid = samples.valid.clone()
    valid[1, 1:] = 0.0
    samples = replace(samples, valid=valid)
    network = process()
    torch.manual_seed(8)
    nll, divergence = loss_terms(network, samples, torch.float32)
    torch.autograd.backward(nll + divergence)

    assert all(p.grad is None or torch.isfinite(p.grad).all() for p in network.parameters())
    assert evaluate(network, samples).rmse > 0.0


def test_predictions_from_the_prior_do_not_know_the_outcomes() -> None:
    """Other outcomes of the targets leave them as they are; with the leak they change."""
    network, samples = process(), some_samples()
    _, targets = predict_targets(network, samples)
    is_target = (samples.inputs[:, :, None, 0] == targets.inputs[:, None, :, 0]).any(dim=2)
    other = replace(samples, targets=torch.where(is_target[..., None], -samples.targets, samples.targets))
    with torch.no_grad():
        honest = [predict_targets(network, given)[0].mean for given in (samples, other)]
        leaked = [predict_targets(network, given, leak=True)[0].mean for given in (samples, other)]

    assert torch.equal(honest[0], honest[1])
    assert not torch.allclose(leaked[0], leaked[1], atol=1e-3)


def test_measuring_draws_the_same_support_and_disturbs_no_generator() -> None:
    """The same figures again, whatever torch's generator did before, and the generator is where it was."""
    network, samples = process().train(), some_samples()
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first = evaluate(network, samples)

    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(6)
    assert evaluate(network, samples) == first
    assert network.training


def test_bfloat16_products_leave_float32_losses() -> None:
    """Rounded products move the loss a little; losses and gradients stay float32."""
    network, samples = process(), some_samples()
    terms = []
    for dtype in (torch.float32, torch.bfloat16):
        torch.manual_seed(8)
        terms.append(loss_terms(network, samples, dtype))
    torch.autograd.backward(terms[1])

    assert {term.dtype for term in terms[1]} == {torch.float32}
    assert terms[1][0].item() == pytest.approx(terms[0][0].item(), rel=0.05)
    assert network.last.weight.grad is not None
    assert network.last.weight.grad.dtype is torch.float32
