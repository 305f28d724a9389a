"""The attentive neural process: its size and its equations."""

import pytest
import torch

from tests.training import reference_equations
from tests.training.networks.fixed_process import fixed_process
from tests.training.reference_equations import array_of
from training.networks.neural_process import Points

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
