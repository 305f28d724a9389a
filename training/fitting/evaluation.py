"""Error, likelihood and calibration on held-out objects: the paper's measures, and coverage beside them."""

import math
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from service.model.tensors import FloatArray
from training.fitting.neural_process_step import SUPPORT_PUSHES, predict_targets
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PushNetwork

DISTANCE_MM_PER_RMSE: Final = 21.92  # the paper's factor: norm of the x and y output deviations
COVERAGE_LEVELS: Final = (0.50, 0.90, 0.95)
_REGIONS: Final = (2.366, 6.251, 7.815)  # chi-squared of 3 outputs at these levels: the edges of the joint regions


@dataclass(frozen=True)
class Evaluation:
    """Measures over all valid samples and their outputs, in normalised units unless a name says otherwise."""

    rmse: float
    std: float  # exp of the mean predicted log standard deviation
    distance_mm: float
    nll: float  # per push, summed over the outputs
    coverage: dict[float, float]  # share of true values inside each central interval, by its probability
    sharpness: tuple[float, ...]  # mean predicted std of each output (pushes: in metres, metres, radians)


@dataclass(frozen=True)
class Predictions:
    """Predicted Gaussians of valid samples beside their outcomes, normalised."""

    mean: FloatArray  # (n, outputs)
    log_std: FloatArray  # (n, outputs)
    outcome: FloatArray  # (n, outputs)
    inputs: FloatArray  # (n, inputs)
    objects: npt.NDArray[np.int64]  # (n,) number of each sample's object
    target_std: tuple[float, ...]  # the unit of each output

    def measures(self) -> "Evaluation":
        """Measure these predictions."""
        return measure(self.mean, self.log_std, self.outcome, self.target_std)

    def regions(self) -> list[float]:
        """Return the share of outcomes inside the joint region of 3 outputs at each coverage level."""
        distance = np.sum(self.z() ** 2, axis=-1)
        return [float(np.mean(distance <= edge)) for edge in _REGIONS]

    def z(self) -> npt.NDArray[np.float64]:
        """Return the standardised errors (n, outputs)."""
        return standardised(self.mean, self.log_std, self.outcome)

    def select(self, rows: npt.NDArray[np.bool_]) -> "Predictions":
        """Return some of the samples."""
        mean, log_std, outcome, inputs = (part[rows] for part in (self.mean, self.log_std, self.outcome, self.inputs))
        return Predictions(mean, log_std, outcome, inputs, self.objects[rows], self.target_std)

    def scaled(self, factor: npt.ArrayLike) -> "Predictions":
        """Return the predictions with their deviations multiplied by one factor, or by one for each sample (n,)."""
        log_factor = np.log(np.asarray(factor, dtype=np.float32)).reshape(-1, 1)
        return replace(self, log_std=self.log_std + log_factor)


def joined(parts: list[Predictions]) -> Predictions:
    """Return predictions of the same objects as one."""
    return Predictions(
        np.concatenate([part.mean for part in parts]),
        np.concatenate([part.log_std for part in parts]),
        np.concatenate([part.outcome for part in parts]),
        np.concatenate([part.inputs for part in parts]),
        np.concatenate([part.objects for part in parts]),
        parts[0].target_std,
    )


def evaluate(network: PushNetwork | NeuralProcess, samples: Samples, leak: bool = False) -> Evaluation:
    """Measure a network on samples. See ``predictions``."""
    return predictions(network, samples, leak).measures()


def predictions(
    network: PushNetwork | NeuralProcess,
    samples: Samples,
    leak: bool = False,
    count: int = SUPPORT_PUSHES,
    seed: int = 0,
) -> Predictions:
    """Predict samples. A neural process predicts its target pushes from the prior, given ``count`` pushes by a seed.

    ``leak`` gives a neural process the targets before it predicts them, as the published evaluation does.
    """
    training = network.training
    network.eval()
    with torch.inference_mode():
        if isinstance(network, NeuralProcess):
            found, points = predict_targets(network, samples, seed, leak, count)
            inputs, target, valid = points.inputs, points.targets, points.valid
        else:
            found, inputs = network(samples.inputs, samples.context), samples.inputs
            target, valid = samples.targets, samples.valid
    network.train(training)
    present = valid > 0
    mean, log_std, outcome, rows = (
        values[present].cpu().numpy() for values in (found.mean, found.log_std, target, inputs)
    )
    objects = torch.nonzero(present)[:, 0].cpu().numpy()
    return Predictions(mean, log_std, outcome, rows, objects, samples.target_std)


def standardised(mean: FloatArray, log_std: FloatArray, outcome: FloatArray) -> npt.NDArray[np.float64]:
    """Return the errors over their predicted deviations."""
    error: npt.NDArray[np.float64] = outcome.astype(np.float64) - mean
    return error * np.exp(-log_std.astype(np.float64))


def measure(mean: FloatArray, log_std: FloatArray, outcome: FloatArray, target_std: tuple[float, ...]) -> Evaluation:
    """Measure normalised Gaussians (n, outputs) against normalised outcomes. ``target_std``: the outputs' units."""
    error, z = outcome.astype(np.float64) - mean, standardised(mean, log_std, outcome)
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
