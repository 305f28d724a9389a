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
from service.pushing.poses import DoubleArray, wrap_angles
from training.fitting.evaluation import Predictions
from training.fitting.shape_samples import ROWS_AT_ONCE, Known, ShapeBatch, ShapeSplit, draw_known, shape_batch
from training.networks.push_network import PushNetwork
from training.networks.shape_network import SMALL_M, ShapeNetwork
from training.omnipush.published import published_normalisation
from training.tables.push_table import PushTable

LEVEL: Final = 0.9  # at which the factor is exact
REGION: Final = 6.251  # chi-squared of 3 outputs at this level
SEEN: Final = "held-out-objects"  # of families that were trained on
UNSEEN: Final = "held-out-families"


@dataclass(frozen=True)
class Factor:
    """Conformal factor on deviations. It grows for objects smaller than ``SMALL_M``, see ``ShapeNetwork``."""

    scale: float
    small: float

    def of(self, size_m: DoubleArray) -> DoubleArray:
        """Return the factors (n,) of pushes of objects with these sizes (n,)."""
        factors: DoubleArray = self.scale * np.maximum(SMALL_M / size_m, 1.0) ** self.small
        return factors


@dataclass(frozen=True)
class ShapeFigures:
    """Held-out predictions by the name of the part, calibrated, and the factor."""

    factor: Factor
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


def conformal_factor(found: Predictions, size_m: DoubleArray) -> Factor:
    """Return the factor with which regions of all objects hold at least ``LEVEL``, and so do those of small ones.

    It is that of all objects, and never less, because a table that exists may scatter more than a simulated one. Below
    half of ``SMALL_M``, the power is the least with which regions hold that share.
    """
    scale = region_factor(found)
    rows = size_m < 0.5 * SMALL_M
    if not rows.any():
        return Factor(scale, 0.0)
    distances = np.maximum(np.sum(found.z()[rows] ** 2, axis=1), 1e-9)
    powers = np.sort(np.log(np.sqrt(distances / REGION) / scale) / np.log(SMALL_M / size_m[rows]))
    rank = min(len(powers), math.ceil((len(powers) + 1) * LEVEL))
    return Factor(scale, max(float(powers[rank - 1]), 0.0))


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

    def sizes(batch: ShapeBatch, of: Predictions) -> DoubleArray:
        """Return the sizes (n,) of the objects of predictions."""
        size_m: DoubleArray = batch.contexts[-1][of.objects, 2].astype(np.float64)
        return size_m

    batch, seen = found(split.held_out)
    size_m, odd = sizes(batch, seen), seen.objects % 2 == 1
    halves = [conformal_factor(seen.select(rows), size_m[rows]) for rows in (odd, ~odd)]  # the factor of the other half
    each = np.where(odd, halves[1].of(size_m), halves[0].of(size_m))
    factor = conformal_factor(seen, size_m)
    predictions, batches = {SEEN: seen.scaled(each)}, {SEEN: batch}
    if split.unseen is not None:
        batches[UNSEEN], unseen = found(split.unseen)
        predictions[UNSEEN] = unseen.scaled(factor.of(sizes(batches[UNSEEN], unseen)))
    return ShapeFigures(factor, predictions, batches)
