"""Evaluation: measures against figures computed by hand, and coverage against samples of the prediction itself."""

import math

import numpy as np
import pytest
import torch

from service.model.tensors import ContextKind, FloatArray
from training.fitting.evaluation import DISTANCE_MM_PER_RMSE, Evaluation, evaluate, measure
from training.fitting.samples import Samples
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.omnipush.published import published_normalisation
from training.omnipush.pushes import Pushes

UNIT = (0.01, 0.02, 0.5)

# Two pushes: errors 1, 2, 2 and 0, 0, 4. Standard deviations 1, 2, 4 and 1, 2, 1.
OUTCOME = np.array([[1.0, 2.0, 2.0], [0.0, 0.0, 4.0]], dtype=np.float32)
MEAN = np.zeros((2, 3), dtype=np.float32)
LOG_STD = np.log([[1.0, 2.0, 4.0], [1.0, 2.0, 1.0]]).astype(np.float32)


def pushes_of(pushers: FloatArray, outcomes: FloatArray, valid: FloatArray) -> Pushes:
    """Make pushes of the first objects of a list, without files."""
    descriptors = ("1a2b3c4a", "4a4a4a4a", "2B3a1a1a")[: len(pushers)]
    return Pushes(descriptors, pushers, outcomes, valid, "a test", "0" * 64)


@pytest.fixture
def by_hand() -> Evaluation:
    """Measure the two pushes above."""
    return measure(MEAN, LOG_STD, OUTCOME, UNIT)


def test_rmse_is_over_all_pushes_and_outputs(by_hand: Evaluation) -> None:
    """The RMSE of both pushes is the root of (1 + 4 + 4 + 0 + 0 + 16) / 6."""
    assert by_hand.rmse == pytest.approx(math.sqrt(25.0 / 6.0))


def test_std_is_the_geometric_mean_of_the_predicted_ones(by_hand: Evaluation) -> None:
    """The STD of both pushes is the sixth root of 1 * 2 * 4 * 1 * 2 * 1."""
    assert by_hand.std == pytest.approx(16.0 ** (1.0 / 6.0))


def test_distance_is_rmse_in_the_paper_s_millimetres(by_hand: Evaluation) -> None:
    """Distance is RMSE times 21.92 mm, the norm of the published x and y output deviations."""
    assert by_hand.distance_mm == pytest.approx(21.92 * math.sqrt(25.0 / 6.0))
    assert 1000.0 * np.linalg.norm(published_normalisation().output_std[:2]) == pytest.approx(
        DISTANCE_MM_PER_RMSE, abs=0.005
    )


def test_nll_is_per_push_and_summed_over_the_outputs(by_hand: Evaluation) -> None:
    """NLL sums half squares (1, 1, 0.5 and 0, 0, 4), log deviations, and 1.5 log(2 pi) per push."""
    squares = 0.5 * (1.0 + 1.0 + 0.25 + 16.0)
    assert by_hand.nll == pytest.approx((squares + math.log(16.0)) / 2.0 + 1.5 * math.log(2.0 * math.pi))


def test_coverage_counts_values_inside_the_intervals(by_hand: Evaluation) -> None:
    """Of the standardised errors 1, 1, 0.5, 0, 0, 4 three are below 0.674, five below 1.645 and five below 1.960."""
    assert by_hand.coverage == pytest.approx({0.50: 3 / 6, 0.90: 5 / 6, 0.95: 5 / 6})


def test_sharpness_is_the_mean_std_in_si_units(by_hand: Evaluation) -> None:
    """Sharpness is the mean std of each output times its unit: metres, metres, radians."""
    assert by_hand.sharpness == pytest.approx((0.01, 0.04, 1.25))


def test_a_gaussian_covers_its_own_samples() -> None:
    """Coverage of samples of the prediction equals each interval's level. 60,000 values leave 0.2 % noise."""
    rng = np.random.default_rng(3)
    mean, log_std = rng.normal(size=(20_000, 3)), rng.normal(size=(20_000, 3))
    outcome = rng.normal(mean, np.exp(log_std))

    found = measure(mean.astype(np.float32), log_std.astype(np.float32), outcome.astype(np.float32), UNIT)
    assert found.coverage == pytest.approx({0.50: 0.50, 0.90: 0.90, 0.95: 0.95}, abs=0.01)


def test_an_overconfident_gaussian_covers_less() -> None:
    """With half the true deviation, the 95 % interval covers as much as one of 0.98 sigma: 67 %."""
    rng = np.random.default_rng(4)
    zeros = np.zeros((20_000, 3), dtype=np.float32)
    outcome = rng.normal(0.0, 2.0, zeros.shape).astype(np.float32)

    assert measure(zeros, zeros, outcome, UNIT).coverage[0.95] == pytest.approx(0.673, abs=0.01)


def test_padding_is_left_out_of_every_measure() -> None:
    """Values in padded rows do not change any measure, and count as soon as the rows are marked valid."""
    torch.manual_seed(5)
    network, rng = PushNetwork(METHODS["FCN + CM"], PUSH_SHAPES[ContextKind.INDICATOR]), np.random.default_rng(6)
    pushers, outcomes = rng.normal(0.0, 0.05, (2, 2, 4, 3)).astype(np.float32)
    valid = np.array([[1, 1, 1, 1], [1, 1, 0, 0]], dtype=np.float32)
    found = evaluate(network, Samples.of(pushes_of(pushers, outcomes, valid), ContextKind.INDICATOR))

    pushers[1, 2:], outcomes[1, 2:] = 9.0, -9.0
    junk = evaluate(network, Samples.of(pushes_of(pushers, outcomes, valid), ContextKind.INDICATOR))
    assert junk == found
    counted = evaluate(network, Samples.of(pushes_of(pushers, outcomes, np.ones_like(valid)), ContextKind.INDICATOR))
    assert counted.rmse > 10.0 * found.rmse


def test_a_network_is_measured_on_its_predictions() -> None:
    """The errors of a network with constant output are the distances of the outcomes from that output."""
    network = PushNetwork(METHODS["FCN"], PUSH_SHAPES[ContextKind.INDICATOR])
    with torch.no_grad():
        network.last.weight.zero_()
        network.last.bias.copy_(torch.tensor([0.5, -1.0, 2.0, 0.0, 0.0, 0.0]))
    known = published_normalisation()
    outcomes = (known.output_mean + known.output_std * [[[0.5, -1.0, 2.0], [0.5, -1.0, 5.0]]]).astype(np.float32)
    pushes = pushes_of(np.zeros_like(outcomes), outcomes, np.ones((1, 2), dtype=np.float32))

    found = evaluate(network, Samples.of(pushes, ContextKind.INDICATOR))
    assert found.rmse == pytest.approx(math.sqrt(9.0 / 6.0), rel=1e-5)
    assert found.std == pytest.approx(1.0)
    assert found.sharpness == pytest.approx(tuple(known.output_std))


def test_a_visual_network_is_measured_as_it_is_served() -> None:
    """A visual network is measured with the batch norms' record, and stays in training mode afterwards."""
    torch.manual_seed(5)
    network = PushNetwork(METHODS["FCN + CM"], PUSH_SHAPES[ContextKind.VISUAL])
    views = torch.rand(4, 1, 32, 32)
    network.conditioning(views)
    inputs, targets = torch.randn(2, 4, 6, 3)
    samples = Samples(inputs, targets, torch.ones(4, 6), views, (1.0, 1.0, 1.0))

    together = evaluate(network, samples)
    alone = [evaluate(network, samples.select(torch.tensor([row]))) for row in range(4)]

    assert network.training
    assert together.rmse**2 == pytest.approx(np.mean([found.rmse**2 for found in alone]), rel=1e-5)


def test_a_regression_of_one_output_is_measured() -> None:
    """Samples of one output per push, as in the paper's Gaussian processes, are measured in its unit."""
    found = measure(MEAN[:, :1], LOG_STD[:, :1], OUTCOME[:, :1], (1.0,))

    assert found.rmse == pytest.approx(math.sqrt(0.5))
    assert found.sharpness == pytest.approx((1.0,))
    assert found.nll == pytest.approx(0.25 + 0.5 * math.log(2.0 * math.pi))
