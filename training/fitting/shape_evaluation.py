"""Evaluation of a network of shapes on whole tables, as it is served: in SI units, and with a conformal factor.

The factor is that of the joint regions of x, y and yaw: with it, the region of 90 % holds 90 % of the outcomes of
objects that the network was not trained on. The score of an outcome is its Mahalanobis distance from the Gaussian.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch

from service.model.tensors import FloatArray
from service.pushing.poses import wrap_angles
from training.fitting.evaluation import Predictions
from training.fitting.shape_samples import ROWS_AT_ONCE, Known, ShapeBatch, ShapeSplit, draw_known, shape_batch
from training.networks.push_network import PushNetwork
from training.networks.shape_network import ShapeNetwork
from training.omnipush.published import published_normalisation
from training.tables.push_table import PushTable

LEVEL: Final = 0.9  # at which the factor is exact
REGION: Final = 6.251  # chi-squared of 3 outputs at this level
SEEN: Final = "held-out-objects"  # of families that were trained on
UNSEEN: Final = "held-out-families"


@dataclass(frozen=True)
class ShapeFigures:
    """Held-out predictions by the name of the part, calibrated, and the factor."""

    factor: float
    predictions: dict[str, Predictions]
    batches: dict[str, ShapeBatch]


def predict_shapes(network: PushNetwork, batch: ShapeBatch) -> Predictions:
    """Predict a batch as it is served, without a factor. Predictions are in units of the published deviations."""
    served = ShapeNetwork(network).eval()
    pusher, *contexts, index = batch.tensors()
    parts = []
    with torch.inference_mode():
        for start in range(0, len(pusher), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            parts.append(served(pusher[part], *contexts, index[part]))
    mean, std = (torch.cat(columns).numpy() for columns in zip(*parts, strict=True))
    return normalised(mean, std, batch)


def normalised(mean: FloatArray, std: FloatArray, batch: ShapeBatch) -> Predictions:
    """Return Gaussians (n, 3) in SI units beside the outcomes of a batch, in units of the published deviations."""
    unit = published_normalisation().output_std
    error = batch.outcomes - mean
    error[:, 2] = wrap_angles(error[:, 2])
    middle = (mean / unit).astype(np.float32)
    outcome = (middle + error / unit).astype(np.float32)
    log_std = np.log(std / unit).astype(np.float32)
    return Predictions(middle, log_std, outcome, batch.pusher, batch.context_index, tuple(unit.tolist()))


def touching(found: Predictions) -> Predictions:
    """Return the predictions of pushes that move the object. The others are exactly at rest."""
    return found.select((found.mean != 0.0).any(axis=1))


def region_factor(found: Predictions) -> float:
    """Return the conformal factor on the deviations with which the joint regions of ``LEVEL`` hold that share."""
    distances = np.sort(np.sum(found.z() ** 2, axis=1))
    rank = min(len(distances), math.ceil((len(distances) + 1) * LEVEL))
    return math.sqrt(float(distances[rank - 1]) / REGION)


def evaluate_shapes(network: PushNetwork, split: ShapeSplit, seed: int) -> ShapeFigures:
    """Evaluate a network on held-out objects and on families never seen, with parts of their bodies known at random.

    The factor is that of the held-out objects of families seen. Each half of them is measured with that of the other
    half, because pushes of one object resemble each other.
    """
    rng = np.random.default_rng([seed, 25])

    def found(table: PushTable) -> tuple[ShapeBatch, Predictions]:
        """Predict a table."""
        known: Known = draw_known(table, rng)
        batch = shape_batch(table, known)
        return batch, touching(predict_shapes(network, batch))

    batch, seen = found(split.held_out)
    factors = np.array([region_factor(seen.select(seen.objects % 2 != half)) for half in (0, 1)])
    factor = region_factor(seen)
    predictions, batches = {SEEN: seen.scaled(factors[seen.objects % 2])}, {SEEN: batch}
    if split.unseen is not None:
        batches[UNSEEN], unseen = found(split.unseen)
        predictions[UNSEEN] = unseen.scaled(factor)
    return ShapeFigures(factor, predictions, batches)
