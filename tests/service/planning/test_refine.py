"""Refinement: what pushes tell of a body, with a model in closed form, and with the model that ships."""

from pathlib import Path

import numpy as np
import pytest

from service.inference.bodies_model import BodiesModel
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.planning.bodies import Bodies
from service.planning.refine import MOST_PUSHES, Refined, known_prior, refine, usual_prior
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import ShapeContext, ShapeTensors
from service.registry.loading import load_version
from service.registry.registry import Registry
from tests.served_graphs import BOX

STD = np.array([0.002, 0.002, 0.05])
CENTRE = (0.02, -0.01)


class Lever:
    """Model in closed form: a push moves the object along, and turns it by its lever about the centre of mass."""

    def __init__(self) -> None:
        self.rows = 0

    def __call__(self, bodies: ShapeTensors, pushes: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
        """Return the motions, and the same deviations for all."""
        self.rows += len(bodies.body) * len(pushes)
        shares, points = bodies.support[..., 2], bodies.support[..., :2]
        centre = bodies.body[:, 3:5].astype(np.float64)
        square = (shares * ((points - centre[:, None]) ** 2).sum(axis=2)).sum(axis=1)
        x, y, angle, length = pushes.T
        lever = np.cos(angle) * (y - centre[:, 1:]) - np.sin(angle) * (x - centre[:, :1])
        turn = -length * lever / (square[:, None] + lever**2)
        shape = turn.shape
        along = length * square[:, None] / (square[:, None] + lever**2)
        mean = np.stack([along * np.cos(angle), along * np.sin(angle), turn], axis=2)
        return mean, np.broadcast_to(STD, (*shape, 3))


def pushes_around(count: int, seed: int = 0) -> DoubleArray:
    """Return pushes from all around a box."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi, count)
    aside = rng.uniform(-0.03, 0.03, count)
    x, y = -0.1 * np.cos(angle) - aside * np.sin(angle), -0.1 * np.sin(angle) + aside * np.cos(angle)
    return np.column_stack([x, y, angle, np.full(count, 0.04)])


def observed(shape: ShapeContext, pushes: DoubleArray, seed: int = 0) -> DoubleArray:
    """Return the outcomes of pushes of a body, with noise."""
    tensors = ShapeTensors(*(part[None] for part in shape.tensors()))
    mean, std = Lever()(tensors, pushes)
    return np.asarray(mean[0] + std[0] * np.random.default_rng(seed).standard_normal((len(pushes), 3)))


def learn(pushes: DoubleArray, outcomes: DoubleArray, shape: ShapeContext | None = None, seed: int = 0) -> Refined:
    """Return what pushes tell of a box."""
    bodies = Bodies(shape or ShapeContext(BOX))
    return refine(Lever(), bodies, usual_prior(bodies), pushes, outcomes, seed)


def off_by(found: Refined) -> float:
    """Return the distance of the centre of mass from the true one."""
    assert found.context.centre_of_mass_m is not None
    return float(np.hypot(*np.subtract(found.context.centre_of_mass_m, CENTRE)))


def test_more_pushes_tell_more() -> None:
    """The centre of mass is found within its std, which falls with the number of pushes."""
    shape = ShapeContext(BOX, CENTRE)
    stds = []
    for count in (1, 5, 50):
        pushes = pushes_around(count)
        found = learn(pushes, observed(shape, pushes))
        stds.append(float(np.hypot(*found.std[:2])))
        assert off_by(found) < 4.0 * stds[-1]
        assert found.outlier_probability.max() < 0.5
    assert stds[0] > 1.5 * stds[1] > 1.5 * 1.5 * stds[2]
    assert off_by(found) < 0.001


def test_pressure_is_found() -> None:
    """Weight at the rim, or in the middle, is told apart from an even spread."""
    pushes = pushes_around(40)
    for alike in (-1.0, 1.0):
        found = learn(pushes, observed(ShapeContext(BOX, pressure=(alike, 0.0, alike)), pushes))
        xx, _, yy = found.context.pressure or (0.0, 0.0, 0.0)
        assert np.sign(alike) * (xx + yy) > 1.0


@pytest.mark.parametrize("kind", ["slipped", "flipped", "turned frame"])
def test_a_fifth_of_outliers_spoils_nothing(kind: str) -> None:
    """Three of fifteen outcomes that no body explains are named, and the centre of mass is as near as without them."""
    pushes = pushes_around(15, seed=3)
    outcomes = observed(ShapeContext(BOX, CENTRE), pushes)
    clean = off_by(learn(pushes, outcomes))
    wrong = outcomes.copy()
    x, y, yaw = outcomes[[2, 7, 11]].T
    wrong[[2, 7, 11]] = {
        "slipped": np.zeros((3, 3)),
        "flipped": np.column_stack([x, y, yaw + 2.0]),
        "turned frame": np.column_stack([-y, x, yaw]),
    }[kind]
    found = learn(pushes, wrong)
    assert {2, 7, 11} <= set(np.flatnonzero(found.outlier_probability > 0.5).tolist())
    assert (found.outlier_probability > 0.5).sum() <= 4
    assert off_by(found) < clean + 0.002


def test_no_push_that_moves_anything_leaves_the_prior() -> None:
    """A push that is explained by every body leaves the stated body, and its uncertainty."""

    class Still(Lever):
        """Model of an object that never moves."""

        def __call__(self, bodies: ShapeTensors, pushes: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
            """Return no motion."""
            mean, std = super().__call__(bodies, pushes)
            return np.zeros_like(mean), std

    bodies = Bodies(ShapeContext(BOX, (0.01, 0.0), 0.3))
    found = refine(Still(), bodies, usual_prior(bodies), pushes_around(3), np.zeros((3, 3)))
    assert found.context.centre_of_mass_m == pytest.approx((0.01, 0.0), abs=0.003)
    assert found.context.friction == pytest.approx(0.3, rel=0.15)
    assert (found.std / found.prior_std).min() > 0.7


def test_the_origin_of_the_frame_does_not_matter() -> None:
    """A frame 3 m away gives the same body: outcomes are large there, because the object turns about a far origin."""
    away = np.array([3.0, -2.0])
    pushes = pushes_around(8)
    outcomes = observed(ShapeContext(BOX, CENTRE), pushes)
    near = learn(pushes, outcomes)
    far_pushes, far_outcomes = pushes.copy(), outcomes.copy()
    far_pushes[:, :2] += away
    cos, sin = np.cos(outcomes[:, 2]), np.sin(outcomes[:, 2])
    turned = np.stack([cos * away[0] - sin * away[1], sin * away[0] + cos * away[1]], axis=1)
    far_outcomes[:, :2] += away - turned
    far = learn(far_pushes, far_outcomes, ShapeContext(Outline.of(BOX.corners + away)))
    assert far.context.centre_of_mass_m is not None
    assert np.subtract(far.context.centre_of_mass_m, away) == pytest.approx(near.context.centre_of_mass_m, abs=1e-4)


def test_a_posterior_is_the_prior_of_further_pushes() -> None:
    """Ten pushes, and ten more with what the first told, tell about as much as twenty at once."""
    pushes = pushes_around(20)
    outcomes = observed(ShapeContext(BOX, CENTRE), pushes)
    first = learn(pushes[:10], outcomes[:10])
    bodies = Bodies(first.context)
    second = refine(Lever(), bodies, known_prior(bodies, first.std, first.correlation), pushes[10:], outcomes[10:])
    at_once = learn(pushes, outcomes)
    assert second.std[:2] == pytest.approx(at_once.std[:2], rel=0.4)
    assert off_by(second) < off_by(at_once) + 2.0 * float(at_once.std[:2].max())


def test_a_prior_that_no_refinement_left_is_limited() -> None:
    """Deviations that are far too large or small become possible ones, and the answer stays finite."""
    pushes = pushes_around(4)
    outcomes = observed(ShapeContext(BOX, CENTRE), pushes)
    bodies = Bodies(learn(pushes, outcomes).context)
    usual = usual_prior(bodies).std()
    for std in (np.full(6, 10.0), np.full(6, 1e-9)):
        prior = known_prior(bodies, std, np.eye(6))
        assert (prior.std() <= usual * 1.001).all()
        found = refine(Lever(), bodies, prior, pushes, outcomes)
        assert np.isfinite(found.std).all()
        assert found.std.min() > 1e-9


def test_the_same_seed_gives_the_same_answer_in_bounded_work() -> None:
    """Fifty pushes take as many hypotheses as one, and equal seeds give equal bytes."""
    pushes = pushes_around(MOST_PUSHES)
    outcomes = observed(ShapeContext(BOX, CENTRE), pushes)
    one, same, other = (learn(pushes, outcomes, seed=seed) for seed in (1, 1, 2))
    assert one.std.tobytes() == same.std.tobytes() != other.std.tobytes()
    model, bodies = Lever(), Bodies(ShapeContext(BOX))
    refine(model, bodies, usual_prior(bodies), pushes, outcomes)
    assert model.rows <= 840 * MOST_PUSHES


@pytest.mark.parametrize("outcome", [(1e6, -1e6, 3.0), (0.0, 0.0, -3.14), (9.0, 9.0, 0.0)])
def test_absurd_outcomes_leave_finite_numbers(outcome: tuple[float, float, float]) -> None:
    """A pose that cannot be is an outlier, and everything stays finite."""
    found = learn(pushes_around(2), np.tile(outcome, (2, 1)))
    assert np.isfinite([*found.std, *found.correlation.ravel(), *(found.context.centre_of_mass_m or (np.nan,))]).all()
    assert found.outlier_probability.min() > 0.5


def test_the_shipped_model_learns_a_centre_of_mass_far_off(shipped_model: BodiesModel) -> None:
    """Ten pushes, as the shipped model predicts them for a loaded box, halve the error of other pushes at least."""
    truth = ShapeContext(BOX, (0.035, 0.0), 0.2)
    pushes = pushes_around(40) + np.array([0.0, 0.0, 0.0, 0.05])
    bodies = Bodies(ShapeContext(BOX))
    outcomes = _predicted(shipped_model, truth, pushes)
    found = refine(shipped_model, bodies, usual_prior(bodies), pushes[:10], outcomes[:10])
    before, after = (
        np.abs(_predicted(shipped_model, shape, pushes[10:]) - outcomes[10:]).mean()
        for shape in (ShapeContext(BOX), found.context)
    )
    assert after < before / 2.0
    assert found.context.centre_of_mass_m is not None
    assert found.context.centre_of_mass_m[0] > 0.015


def _predicted(model: BodiesModel, shape: ShapeContext, pushes: DoubleArray) -> DoubleArray:
    """Return the means (k, 3) of pushes of one body."""
    mean, _ = model(ShapeTensors(*(part[None] for part in shape.tensors())), pushes)
    return mean.reshape(-1, 3)


@pytest.fixture(scope="module")
def shipped_model(project_root: Path) -> BodiesModel:
    """Return the model of any shape that ships."""
    loaded = load_version(Registry(project_root / "models"), OnnxPredictor, "push-shape", 1)
    assert loaded.manifest.context_kind is ContextKind.SHAPE
    return BodiesModel(loaded, "body.context")
