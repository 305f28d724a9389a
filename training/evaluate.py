"""Error, likelihood and calibration on held-out objects: the paper's measures, and what they leave out."""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.contract import FloatArray
from training.data import Normalisation, Pushes, published_normalisation
from training.networks import PushNetwork

DISTANCE_MM_PER_RMSE: Final = 21.92  # the paper's factor: norm of the x and y output deviations
COVERAGE_LEVELS: Final = (0.50, 0.90, 0.95)


@dataclass(frozen=True)
class Evaluation:
    """Figures over all valid pushes and the 3 outputs; normalised units unless a name says otherwise."""

    rmse: float
    std: float  # exp of the mean predicted log standard deviation
    distance_mm: float
    nll: float  # per push, summed over the 3 outputs
    coverage: dict[float, float]  # share of values inside each central interval
    sharpness: tuple[float, float, float]  # mean predicted std in metres, metres, radians


@dataclass(frozen=True)
class NormalisedPushes:
    """Pushes as the networks take them, on the device that fits them."""

    pusher: Tensor  # (objects, pushes, 3)
    outcome: Tensor  # (objects, pushes, 3)
    valid: Tensor  # (objects, pushes)
    context: Tensor  # (objects, 36)

    @classmethod
    def of(cls, pushes: Pushes, device: torch.device) -> "NormalisedPushes":
        """Normalise with the published statistics."""
        known = published_normalisation()
        pusher = (pushes.pushers - known.input_mean) / known.input_std
        outcome = (pushes.outcomes - known.output_mean) / known.output_std
        arrays = (pusher, outcome, pushes.valid, pushes.indicators)
        return cls(*(torch.from_numpy(array.astype(np.float32)).to(device) for array in arrays))


def evaluate(network: PushNetwork, pushes: NormalisedPushes) -> Evaluation:
    """Measure a network on pushes."""
    with torch.inference_mode():
        mean, log_std, _ = network(pushes.pusher, pushes.context)
    present = pushes.valid > 0
    arrays = [values[present].cpu().numpy() for values in (mean, log_std, pushes.outcome)]
    return measure(arrays[0], arrays[1], arrays[2], published_normalisation())


def measure(mean: FloatArray, log_std: FloatArray, outcome: FloatArray, known: Normalisation) -> Evaluation:
    """The measures of normalised Gaussians (n, 3) against normalised outcomes (n, 3)."""
    error = outcome.astype(np.float64) - mean
    z = error * np.exp(-log_std.astype(np.float64))
    rmse = math.sqrt(float(np.mean(error**2)))
    nll = float(np.mean(np.sum(0.5 * z**2 + log_std + 0.5 * math.log(2.0 * math.pi), axis=-1)))
    coverage = {level: _coverage(z, level) for level in COVERAGE_LEVELS}
    x_m, y_m, yaw_rad = (np.exp(log_std.astype(np.float64)).mean(axis=0) * known.output_std).tolist()
    std = math.exp(float(np.mean(log_std, dtype=np.float64)))
    return Evaluation(rmse, std, rmse * DISTANCE_MM_PER_RMSE, nll, coverage, (x_m, y_m, yaw_rad))


def _coverage(z: npt.NDArray[np.float64], level: float) -> float:
    """Share of standardised errors inside the central interval of this probability."""
    half_width = NormalDist().inv_cdf(0.5 + level / 2.0)
    return float(np.mean(np.abs(z) <= half_width))
