"""Refinement: a few pushes of one object, and where it ended up, tell of its body.

A posterior over centre of mass, contact friction and pressure (``bodies``) is sampled by adaptive importance sampling.
The first hypotheses are drawn from the prior. Each later round draws from a Student distribution about the weighted
hypotheses so far (population Monte Carlo: Cappe, Guillin, Marin, Robert 2004). Weights are those of the mixture of all
rounds (Veach, Guibas 1995). The mean of the posterior is the refined body. No weight of a network changes.

- **Prior**: about the body that the context states, or about the usual one. A centre of mass is near it, or anywhere.
- **Likelihood**: a Student distribution about the model's mean for a hypothesis, with the model's own deviations. It is
  mixed with a wide one, so that an outcome that no body explains, as of a slipped gripper, is an **outlier** and tells
  almost nothing.

Constants were chosen on simulated pushes. ``benchmarks/refine.py`` measures them there and on recorded pushes.
"""

import math
import zlib
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from service.planning.bodies import PARAMETERS, Bodies
from service.planning.mixtures import Gaussian, Mixture, Student, student_log_density
from service.planning.push_model import Rows
from service.pushing.poses import DoubleArray, wrap_angles
from service.pushing.shape_context import SURE, ShapeContext, ShapeTensors

MOST_PUSHES: Final = 50
FIRST, LATER = 160, 96  # hypotheses of a round
MOST_ROUNDS: Final = 8
ENOUGH_EFFECTIVE: Final = 80.0  # hypotheses, after which no further round is drawn
NEAR, ANYWHERE = 0.04, 0.30  # std of the centre of mass about the stated one, in sizes
ANYWHERE_SHARE: Final = 0.3  # of the prior
FRICTION_STD: Final = 0.35  # of its logarithm
ROUND_STD, LONG_STD = 0.9, 0.5  # of the pressure: alike in all directions, and of the difference between them
TAIL: Final = 2.5  # degrees of freedom of an outcome about the model's mean
NAMING_TAIL: Final = 8.0  # likewise where outliers are named: a heavy tail explains most of them, if at a low weight
OUTLIER_TAIL: Final = 1.0  # likewise of an outlier about the pose before the push
OUTLIERS: Final = 0.05  # share that is expected
OUTLIER_SPREAD: Final = 0.6  # of their places in lengths of the push, and of their yaw in rad
LEAST_LENGTH_M: Final = 0.001  # of a push by which outliers spread
PROPOSAL_TAIL: Final = 5.0
WIDER: Final = 1.2  # covariance of a proposal over that of the hypotheses
LEAST_SPREAD: Final = 0.01  # std of a proposal over that of the prior
FEWEST_EFFECTIVE: Final = 24.0  # hypotheses that shape a proposal, and the answer
SUREST: Final = 1e-3  # std of a prior over the usual one
LEAST_STD: Final = 0.01  # of the posterior over that of the prior: hypotheses lie no closer
_FLATTER: Final = 0.8
_IMPOSSIBLE: Final = -1e9


class BodiesModel(Protocol):
    """Model of the pushes of many bodies with one outline."""

    def __call__(self, bodies: ShapeTensors, pushes: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
        """Return mean and std (n, k, 3) of each push (k, 4) of each body (n), in one frame, m, m, rad."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class Refined:
    """Posterior over the body of an object.

    Attributes:
        context: the same object with the mean of the posterior, whose centre of mass may not be sure.
        std: (6,) standard deviations of ``PARAMETERS`` about it.
        correlation: (6, 6).
        prior_std: (6,) standard deviations before the pushes.
        outlier_probability: (k,) of each push.
    """

    context: ShapeContext
    std: DoubleArray
    correlation: DoubleArray
    prior_std: DoubleArray
    outlier_probability: DoubleArray


def usual_prior(bodies: Bodies) -> Mixture:
    """Return the prior about the body that a context states."""
    alike, apart = ROUND_STD**2, LONG_STD**2
    covariances = []
    for spread in (NEAR, ANYWHERE):
        covariance = np.diag([spread**2, spread**2, FRICTION_STD**2, alike + apart, apart, alike + apart])
        covariance[3, 5] = covariance[5, 3] = alike - apart
        covariances.append(covariance)
    near, anywhere = (Gaussian(bodies.stated, covariance) for covariance in covariances)
    return Mixture((near, anywhere), np.array([1.0 - ANYWHERE_SHARE, ANYWHERE_SHARE]))


def known_prior(bodies: Bodies, std: DoubleArray, correlation: DoubleArray) -> Mixture:
    """Return the prior that an earlier refinement left: of the stated body with std (6,) and correlation (6, 6).

    Deviations are limited to those that a refinement can leave.
    """
    usual = usual_prior(bodies).std()
    scaled = np.clip(std / bodies.units(bodies.stated), SUREST * usual, usual)
    covariance = correlation * np.outer(scaled, scaled)
    return Mixture((Gaussian(bodies.stated, covariance),), np.ones(1))


def refine(
    model: BodiesModel,
    bodies: Bodies,
    prior: Mixture,
    pushes: DoubleArray,
    outcomes: DoubleArray,
    seed: int = 0,
) -> Refined:
    """Return the posterior over the body of an object.

    Args:
        model: predicts pushes of hypotheses.
        bodies: of the object.
        prior: see ``usual_prior``.
        pushes: (k, 4) x_m, y_m, angle_rad, length_m of the tip in the object frame, at most ``MOST_PUSHES``.
        outcomes: (k, 3) x_m, y_m, yaw_rad of the object after each push, in its frame before that push.
        seed: of the random numbers.
    """
    # Numbers of their own for each body to start from: errors of sampling must not add up over a chain of refinements.
    told = zlib.crc32((bodies.stated.round(6) + 0.0).tobytes())
    rng = np.random.default_rng([seed, told])
    pushes, outcomes = bodies.in_centroid_frame(pushes, outcomes)
    proposals: list[Mixture | Student] = [prior]
    hypotheses, posterior = np.empty((0, len(PARAMETERS))), np.empty(0)
    while True:
        drawn = proposals[-1].draw(FIRST if len(proposals) == 1 else LATER, rng)
        explained, outlier, possible = _terms(model, bodies, drawn, pushes, outcomes, TAIL)
        likely = np.where(possible, np.logaddexp(explained, outlier).sum(axis=1), _IMPOSSIBLE)
        hypotheses = np.concatenate([hypotheses, drawn])
        posterior = np.concatenate([posterior, prior.log_density(drawn) + likely])
        weights, is_enough = _flattened(posterior - _drawn(hypotheses, proposals))
        if len(proposals) == MOST_ROUNDS or (is_enough and len(proposals) > 1):
            break
        proposals.append(_proposal(hypotheses, weights, prior))
    mean, covariance = _moments(hypotheses, weights)
    covariance += np.diag((LEAST_STD * prior.std()) ** 2)
    std = np.sqrt(np.diagonal(covariance))
    explained, outlier, _ = _terms(model, bodies, mean[None], pushes, outcomes, NAMING_TAIL)
    units = bodies.units(mean)
    return Refined(
        replace(bodies.context(mean), centre_is_sure=math.hypot(*std[:2]) <= SURE),
        std * units,
        covariance / np.outer(std, std),
        prior.std() * units,
        np.exp(outlier - np.logaddexp(explained[0], outlier)),
    )


def _terms(
    model: BodiesModel,
    bodies: Bodies,
    hypotheses: DoubleArray,
    pushes: DoubleArray,
    outcomes: DoubleArray,
    tail: float,
) -> tuple[DoubleArray, DoubleArray, Rows]:
    """Return the log likelihoods (n, k) of hypotheses (n, 6), those (k,) of outliers, and the possible hypotheses."""
    tensors, possible = bodies.tensors(hypotheses)
    mean, std = model(tensors, pushes)
    error = outcomes - mean
    error[..., 2] = wrap_angles(error[..., 2])
    lengths_m = np.maximum(pushes[:, 3], LEAST_LENGTH_M)
    wide = OUTLIER_SPREAD * np.stack([lengths_m, lengths_m, np.ones(len(pushes))], axis=1)
    explained = math.log(1.0 - OUTLIERS) + student_log_density(error, std, tail)
    return explained, math.log(OUTLIERS) + student_log_density(outcomes, wide, OUTLIER_TAIL), possible


def _drawn(hypotheses: DoubleArray, proposals: list[Mixture | Student]) -> DoubleArray:
    """Return the log density (n,) of hypotheses under the mixture of all rounds so far."""
    counts = np.array([FIRST] + [LATER] * (len(proposals) - 1), dtype=np.float64)
    parts = [
        math.log(share) + proposal.log_density(hypotheses)
        for share, proposal in zip(counts / counts.sum(), proposals, strict=True)
    ]
    found: DoubleArray = np.logaddexp.reduce(parts, axis=0)
    return found


def _proposal(hypotheses: DoubleArray, weights: DoubleArray, prior: Mixture) -> Student:
    mean, covariance = _moments(hypotheses, weights)
    return Student(mean, WIDER * covariance + np.diag((LEAST_SPREAD * prior.std()) ** 2), PROPOSAL_TAIL)


def _moments(hypotheses: DoubleArray, weights: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    mean = weights @ hypotheses
    apart = hypotheses - mean
    return mean, (weights[:, None] * apart).T @ apart


def _flattened(logarithms: DoubleArray) -> tuple[DoubleArray, bool]:
    """Return weights (n,), raised to a power below 1 until some of them count, and whether enough do without that."""
    power = 1.0
    while True:
        weights = np.exp(power * (logarithms - logarithms.max()))
        weights /= weights.sum()
        effective = 1.0 / (weights**2).sum()
        if effective >= FEWEST_EFFECTIVE:
            return weights, power == 1.0 and effective >= ENOUGH_EFFECTIVE
        power *= _FLATTER
