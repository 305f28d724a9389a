"""The attentive neural process: its size and its equations."""

import pytest
import torch

from tests.training import reference_equations
from tests.training.networks.fixed_process import fixed_process
from tests.training.reference_equations import array_of
from training.networks.angles import PushForm
from training.networks.neural_process import NeuralProcess, Points

# query, key, value, mixture (128 + 1) 128 each, and scale and shift of the norm
ATTENTION = 4 * 129 * 128 + 2 * 128
# (6 + 1) 128 and two layers
POINT_ENCODER = 7 * 128 + 2 * ATTENTION


def test_the_process_has_the_size_of_its_equations() -> None:
    """Point encoders, latent head, keys, cross-attention and a decoder three times 384 wide have 896,006 parameters."""
    latent_head, place = 3 * 129 * 128, 4 * 128
    decoder = place + 3 * 385 * 384 + 385 * 6
    expected = 2 * POINT_ENCODER + latent_head + place + 2 * ATTENTION + decoder

    assert sum(parameter.numel() for parameter in fixed_process().parameters()) == expected == 896_006


def test_a_forward_pass_is_the_equations() -> None:
    """Latent mean and std, and the Gaussian of each target, agree with the equations written out in numpy."""
    network, generator = fixed_process(), torch.Generator().manual_seed(1)
    (inputs, outcomes), valid = torch.randn(2, 3, 20, 3, generator=generator), torch.ones(3, 20)
    support, targets = (Points(inputs[:, rows], outcomes[:, rows], valid[:, rows]) for rows in (slice(6), slice(6, 20)))
    with torch.no_grad():
        prior_mean, prior_std = network.latent(support)
        mean, log_std = network(support, targets.inputs)

    weights = network.state_dict()
    for row in range(3):
        s_inputs, s_targets, t_inputs = (
            array_of(value[row]) for value in (support.inputs, support.targets, targets.inputs)
        )
        z, std = reference_equations.latent(weights, s_inputs, s_targets)
        expected = reference_equations.neural_process(weights, s_inputs, s_targets, t_inputs, z)
        assert array_of(prior_mean[row]) == pytest.approx(z, abs=1e-4)
        assert array_of(prior_std[row]) == pytest.approx(std, abs=1e-5)
        assert array_of(mean[row]) == pytest.approx(expected[0], abs=1e-3)
        assert array_of(log_std[row]) == pytest.approx(expected[1], abs=1e-3)


def pushes_of(objects: int, count: int, seed: int) -> Points:
    """Draw normal numbers for some pushes of objects."""
    inputs, outcomes = torch.randn(2, objects, count, 3, generator=torch.Generator().manual_seed(seed))
    return Points(inputs, outcomes, torch.ones(objects, count))


def test_pushes_one_by_one_meet_what_is_known_of_their_objects() -> None:
    """Objects that are learnt once, and gathered for pushes in any order, give the predictions of whole objects."""
    torch.manual_seed(3)
    network = NeuralProcess(form=PushForm.PUSH_FRAME, least_std=0.01).eval()
    support, targets, index = pushes_of(3, 6, 1), pushes_of(3, 4, 2), torch.tensor([2, 0, 2, 1])
    with torch.no_grad():
        mean, log_std = network(support, targets.inputs)
        alone = network.predict(network.adapted(support).of(index), targets.inputs[index, 1:2])

    assert torch.allclose(alone[0][:, 0], mean[index, 1], atol=1e-5)
    assert torch.allclose(alone[1][:, 0], log_std[index, 1], atol=1e-5)
    assert (torch.exp(log_std) > 0.01).all()


def test_training_and_evaluation_decode_the_same() -> None:
    """The decoder's first layer is one product in training, and gives the numbers of evaluation without dropout."""
    network, support, targets = fixed_process(), pushes_of(2, 5, 1), pushes_of(2, 3, 2)
    with torch.no_grad():
        known = network.adapted(support)
        found = network._first_decoder_layer(targets.inputs, torch.ones(2, 3, 128), known.latent)
        network.train()
        expected = network._first_decoder_layer(targets.inputs, torch.ones(2, 3, 128), known.latent)

    assert torch.allclose(found, expected, atol=1e-5)


def test_padding_in_a_support_and_the_order_of_its_pushes_do_not_count() -> None:
    """A support with junk in its padding, and one in another order, give the same prediction."""
    torch.manual_seed(3)
    network, targets = NeuralProcess(form=PushForm.PUSH_FRAME).eval(), pushes_of(1, 4, 2)
    support = pushes_of(1, 6, 1)
    padding = torch.full((1, 2, 3), 9.0)
    padded = Points(
        torch.cat([support.inputs, padding], dim=1),
        torch.cat([support.targets, padding], dim=1),
        torch.tensor([[1.0] * 6 + [0.0] * 2]),
    )
    reverse = Points(support.inputs.flip(1), support.targets.flip(1), support.valid)
    with torch.no_grad():
        expected = network(support, targets.inputs)[0]
        for other in (padded, reverse):
            assert torch.allclose(network(other, targets.inputs)[0], expected, atol=1e-4)
