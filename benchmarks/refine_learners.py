"""Learners: models that are told k pushes of an object with their outcomes, and predict other pushes of it.

Each learns anew from every support. Known to all are the outline and the radius of the tip.

    push-shape, refined   the served model with the context that ``client.refine`` returns
    mechanics, fitted     quasi-static mechanics, four parameters fitted by least squares: centre of mass (x, y),
                          contact friction and the moment arm of the pressure. The loss is robust (soft L1), and each
                          parameter has a prior, without which few pushes are worse than none
    push-anp              the paper's meta-learner with the pushes as its support, if it is published. It knows no
                          outline, pushes of 50 mm only, and the objects of Omnipush
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np
from scipy.optimize import least_squares

from service.client import Client, ContextBody
from service.pushing.mechanics import FRICTION, push
from service.pushing.outlines import Outline
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray, wrap_angles

MOST_PUSHES: Final = 10_000  # of a request
_UNITS: Final = np.array([0.0025, 0.0025, 0.05])  # an error of mechanics that is usual, m, m, rad
_PRIOR: Final = np.array([0.1, 0.1, 0.5, 0.3])  # std: sizes, sizes, logarithm, logarithm
_STEP: Final = 0.01
_EVALUATIONS: Final = 15
_COARSE: Final = 12  # steps of mechanics while it is fitted
_SAME_M: Final = 0.001


@dataclass(frozen=True, eq=False)
class Pushes:
    """Pushes of one object: (n, 4) pushers and (n, 3) outcomes, in the frame of its outline."""

    outline: Outline
    pusher_radius_m: float
    pushers: DoubleArray
    outcomes: DoubleArray

    def rows(self, rows: np.ndarray) -> "Pushes":
        """Return some of them."""
        return Pushes(self.outline, self.pusher_radius_m, self.pushers[rows], self.outcomes[rows])


class Predicted(NamedTuple):
    """Predictions: means (n, 3), std (n, 3) or None, and the rows that were named outliers of the support."""

    mean: DoubleArray
    std: DoubleArray | None
    outliers: tuple[int, ...] = ()


class Learner(Protocol):
    """A model that learns from pushes."""

    def __call__(self, support: Pushes, asked: Pushes) -> Predicted:
        """Predict pushes after those of a support, which may have none."""
        ...


class RefinedShape:
    """The served model of any shape with a refined context. ``knows`` is stated in the context, before and after."""

    def __init__(self, client: Client, model: str, knows: Mapping[str, object] | None = None) -> None:
        self._client, self._model, self._knows = client, model, knows or {}

    def __call__(self, support: Pushes, asked: Pushes) -> Predicted:
        """See ``Learner``."""
        context = ContextBody.model_validate(
            {"outline": asked.outline.corners.tolist(), "pusher_radius": asked.pusher_radius_m, **self._knows}
        )
        outliers: tuple[int, ...] = ()
        if len(support.pushers):
            poses, lengths = support.pushers[:, :3], support.pushers[:, 3]
            found = self._client.refine(context, poses, support.outcomes, lengths=lengths, model=self._model)
            context, outliers = found.context, found.outliers
        return Predicted(*_asked(self._client, context, asked, self._model, asked.pushers[:, 3]), outliers)


class FittedMechanics:
    """Quasi-static mechanics with four fitted parameters."""

    def __call__(self, support: Pushes, asked: Pushes) -> Predicted:
        """See ``Learner``."""
        found = np.zeros(len(_PRIOR)) if not len(support.pushers) else self._fitted(support)
        return Predicted(self._pushed(found, asked), None)

    def _fitted(self, support: Pushes) -> DoubleArray:
        def residuals(values: DoubleArray) -> DoubleArray:
            """Return the errors in their usual sizes, and the parameters in those of their priors."""
            error = support.outcomes - self._pushed(values, support, _COARSE)
            error[:, 2] = wrap_angles(error[:, 2])
            return np.concatenate([(error / _UNITS).ravel(), values / _PRIOR])

        start = np.zeros(len(_PRIOR))
        found: DoubleArray = least_squares(
            residuals, start, loss="soft_l1", diff_step=_STEP, x_scale=_PRIOR, max_nfev=_EVALUATIONS
        ).x
        return found

    @staticmethod
    def _pushed(values: DoubleArray, asked: Pushes, steps: int = 25) -> DoubleArray:
        outline = asked.outline
        return push(
            outline,
            asked.pushers,
            asked.pusher_radius_m,
            FRICTION * float(np.exp(values[2])),
            outline.centroid_m + values[:2] * outline.size_m,
            steps,
            float(np.exp(values[3])),
        )


class MetaLearner:
    """The paper's meta-learner with a support as its context, in a frame with its origin at the centroid."""

    def __init__(self, client: Client, model: str) -> None:
        self._client, self._model = client, model

    def __call__(self, support: Pushes, asked: Pushes) -> Predicted:
        """See ``Learner``. Without a support it is told of an object that a push has missed."""
        origin = asked.outline.centroid_m
        known = _centred(support, origin) if len(support.pushers) else None
        pushers = [[-1.0, 0.5, 0.0]] if known is None else known.pushers[:, :3].tolist()
        outcomes = [[0.0, 0.0, 0.0]] if known is None else known.outcomes.tolist()
        context = ContextBody.model_validate({"support": {"pushers": pushers, "outcomes": outcomes}})
        mean, std = _asked(self._client, context, _centred(asked, origin), self._model, None)
        return Predicted(_from_centre(mean, origin), std)


def knows_meta_learner(client: Client) -> bool:
    """Return whether the meta-learner is published, and takes supports."""
    models = {model.name for model in client.list_models().models}
    return "push-anp" in models and "support" in ContextBody.model_fields


def all_of_one_length(pushes: Pushes) -> bool:
    """Return whether a model that knows one length can be asked."""
    return bool((np.abs(pushes.pushers[:, 3] - PUSH_LENGTH_M) < _SAME_M).all())


def _asked(
    client: Client, context: ContextBody, asked: Pushes, model: str, lengths: DoubleArray | None
) -> tuple[DoubleArray, DoubleArray]:
    parts: Iterator[slice] = (slice(first, first + MOST_PUSHES) for first in range(0, len(asked.pushers), MOST_PUSHES))
    answers = [
        client.predict_batch(
            asked.pushers[part, :3], context, model=model, lengths=None if lengths is None else lengths[part]
        )
        for part in parts
    ]
    mean, std = (np.concatenate([getattr(each, name) for each in answers]) for name in ("mean", "std"))
    return mean.astype(np.float64), std.astype(np.float64)


def _centred(pushes: Pushes, origin: DoubleArray) -> Pushes:
    """Return pushes in a frame whose origin is moved."""
    moved = pushes.pushers - np.array([*origin, 0.0, 0.0])
    return Pushes(pushes.outline, pushes.pusher_radius_m, moved, _from_centre(pushes.outcomes, -origin))


def _from_centre(outcomes: DoubleArray, origin: DoubleArray) -> DoubleArray:
    """Return outcomes (n, 3) in a frame whose origin is moved to minus ``origin``."""
    cos, sin = np.cos(outcomes[:, 2]), np.sin(outcomes[:, 2])
    x, y = origin
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)
    found = outcomes.copy()
    found[:, :2] += origin - turned
    return found
