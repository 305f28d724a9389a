"""Calibration on held-out objects, and coverage by band: how far away a push starts, and how far off-centre it aims.

The deviations of a network are multiplied by a conformal factor, with which the central 90 % intervals hold 90 % of the
outcomes of objects that it was not trained on. Pushes of one object resemble each other, so figures with a factor are
always of other objects than the factor: each half of the held-out objects is measured with the factor of the other.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import Final

import numpy as np
import torch

from training.fitting.evaluation import Evaluation, Predictions, joined, predictions
from training.fitting.samples import Samples
from training.networks.push_network import PushNetwork
from training.omnipush.published import published_normalisation

CAMERA: Final = "camera"
CAMERA_VIEWS: Final = 4  # of each held-out object
LEVEL: Final = 0.9  # the level at which the factor is exact
STARTS_MM: Final = (0.0, 60.0, 75.0, 90.0, 105.0, math.inf)  # from the centre of the object
AIMS_MM: Final = (0.0, 12.0, 24.0, 36.0, 48.0, 60.0, 72.0, math.inf)  # from the centre to the line of the push


@dataclass(frozen=True)
class Band:
    """Pushes with a start or an aim in a band, and how well they are predicted."""

    quantity: str  # start or aim
    low_mm: float
    high_mm: float
    pushes: int
    found: Evaluation

    def name(self) -> str:
        """Return the band as a text, such as ``start 60 to 75 mm``."""
        upper = "mm and more" if math.isinf(self.high_mm) else f"to {self.high_mm:.0f} mm"
        return f"{self.quantity} {self.low_mm:.0f} {upper}"


def conformal_factor(found: Predictions) -> float:
    """Return the factor on the deviations with which the central intervals of ``LEVEL`` hold that share of outcomes."""
    errors = np.sort(np.abs(found.z()), axis=None)
    rank = min(len(errors), math.ceil((len(errors) + 1) * LEVEL))
    return float(errors[rank - 1]) / NormalDist().inv_cdf(0.5 + LEVEL / 2.0)


@dataclass(frozen=True)
class Calibrated:
    """Held-out predictions of a network, calibrated, by the kind of view, and the factor for other objects."""

    factor: float  # of all held-out objects
    predictions: dict[str, Predictions]  # "" as drawn or without views, CAMERA as cameras see the same objects


def calibrate(raw: dict[str, Predictions]) -> Calibrated:
    """Scale the deviations of each half of the objects by the conformal factor of the other half.

    The factors are those of all kinds of views together, because a network does not know which kind it will see.
    """
    every = joined(list(raw.values()))
    factors = np.array([conformal_factor(every.select(every.objects % 2 != half)) for half in (0, 1)])
    scaled = {kind: found.scaled(factors[found.objects % 2]) for kind, found in raw.items()}
    return Calibrated(conformal_factor(every), scaled)


def held_out_views(samples: Samples) -> dict[str, list[Samples]]:
    """Return samples by the kind of view: as drawn, and as some of their camera views if there are any."""
    found = {"": [samples]}
    if samples.views is not None:
        last = min(CAMERA_VIEWS, samples.views.shape[1] - 1)
        found[CAMERA] = [samples.seen(torch.full((len(samples.inputs),), view)) for view in range(1, last + 1)]
    return found


def calibrated(network: PushNetwork, samples: Samples) -> Calibrated:
    """Predict held-out samples of all kinds of views, and calibrate the predictions."""
    return calibrate(
        {kind: joined([predictions(network, seen) for seen in each]) for kind, each in held_out_views(samples).items()}
    )


def bands(found: Predictions) -> Iterator[Band]:
    """Measure predictions by ring of starts, then by band of aims. Bands without pushes are left out."""
    known = published_normalisation()
    x_m, y_m, angle_rad = (found.inputs * known.input_std + known.input_mean).T
    quantities = (
        ("start", 1e3 * np.hypot(x_m, y_m), STARTS_MM),
        ("aim", 1e3 * np.abs(x_m * np.sin(angle_rad) - y_m * np.cos(angle_rad)), AIMS_MM),
    )
    for quantity, values_mm, edges in quantities:
        for low, high in pairwise(edges):
            inside = (values_mm >= low) & (values_mm < high)
            if inside.any():
                yield Band(quantity, low, high, int(inside.sum()), found.select(inside).measures())
