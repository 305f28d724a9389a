"""Error, likelihood and calibration on held-out objects: the paper's measures, and coverage beside them."""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from service.model.tensors import FloatArray
from training.fitting.neural_process_step import predict_targets
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PushNetwork

DISTANCE_MM_PER_RMSE: Final = 21.92  # the paper's factor: norm of the x and y output deviations
COVERAGE_LEVELS: Final = (0.50, 0.90, 0.95)


@dataclass(frozen=True)
class Evaluation:
    """Measures over all valid samples and their outputs, in normalised units unless a name says otherwise."""

    rmse: float
    std: float  # exp of the mean predicted log standard deviation
    distance_mm: float
    nll: float  # per push, summed over the outputs
    coverage: dict[float, float]  # share of true values inside each central interval, by its probability
    sharpness: tuple[float, ...]  # mean predicted std of each output (pushes: in metres, metres, radians)


def evaluate(network: PushNetwork | NeuralProcess, samples: Samples, leak: bool = False) -> Evaluation:
    """Measure a network on samples. A neural process predicts its target pushes from the prior.

    ``leak`` gives a neural process the targets before it predicts them, as the published evaluation does.
    """
    training = network.training
    network.eval()
    with torch.inference_mode():
        if isinstance(network, NeuralProcess):
            found, points = predict_targets(network, samples, leak=leak)
            target, valid = points.targets, points.valid
        else:
            found, target, valid = network(samples.inputs, samples.context), samples.targets, samples.valid
    network.train(training)
    mean, log_std, outcome = (values[valid > 0].cpu().numpy() for values in (found.mean, found.log_std, target))
    return measure(mean, log_std, outcome, samples.target_std)


def measure(mean: FloatArray, log_std: FloatArray, outcome: FloatArray, target_std: tuple[float, ...]) -> Evaluation:
    """Measure normalised Gaussians (n, outputs) against normalised outcomes. ``target_std``: the outputs' units."""
    error = outcome.astype(np.float64) - mean
    z = error * np.exp(-log_std.astype(np.float64))
    rmse = math.sqrt(float(np.mean(error**2)))
    nll = float(np.mean(np.sum(0.5 * z**2 + log_std + 0.5 * math.log(2.0 * math.pi), axis=-1)))
    coverage = {level: _coverage(z, level) for level in COVERAGE_LEVELS}
    sharpness = tuple((np.exp(log_std.astype(np.float64)).mean(axis=0) * np.array(target_std)).tolist())
    std = math.exp(float(np.mean(log_std, dtype=np.float64)))
    return Evaluation(rmse, std, rmse * DISTANCE_MM_PER_RMSE, nll, coverage, sharpness)


def _coverage(z: npt.NDArray[np.float64], level: float) -> float:
    """Return the share of standardised errors inside the central interval of this probability."""
    half_width = NormalDist().inv_cdf(0.5 + level / 2.0)
    return float(np.mean(np.abs(z) <= half_width))
