"""Evaluation of a neural process with supports of few pushes and of many, as it is served.

The deviations of each number of support pushes have a conformal factor of their own (see ``bands``). Targets are the
same for every number, so figures of two numbers differ by the support alone.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from service.model.tensors import FloatArray
from service.pushing.contexts import MAX_SUPPORT
from training.fitting.bands import calibrate
from training.fitting.evaluation import Predictions, joined, predictions
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess

COUNTS: Final = (50, 20, 10, 5, 2, 1)  # pushes in a support, the paper's number first
DRAWS: Final = 3  # of a support for each object: which pushes they are makes a difference


@dataclass(frozen=True)
class SupportFigures:
    """Held-out predictions by the number of support pushes, calibrated, and their factors for other objects."""

    factors: dict[int, float]
    predictions: dict[int, Predictions]

    def scales(self) -> FloatArray:
        """Return the factor for every number of support pushes, (51,), interpolated in proportion to numbers."""
        counts = np.array(sorted(self.factors))
        factors = [self.factors[count] for count in counts.tolist()]
        every = np.maximum(np.arange(MAX_SUPPORT + 1), 1)
        return np.exp(np.interp(np.log(every), np.log(counts), np.log(factors))).astype(np.float32)


def evaluate_supports(network: NeuralProcess, samples: Samples) -> SupportFigures:
    """Predict held-out samples with supports of each number of pushes, and calibrate the predictions."""
    found = {
        count: calibrate({"": joined([predictions(network, samples, count=count, seed=seed) for seed in range(DRAWS)])})
        for count in COUNTS
    }
    return SupportFigures(
        {count: each.factor for count, each in found.items()},
        {count: each.predictions[""] for count, each in found.items()},
    )
