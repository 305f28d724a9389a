"""Shipped models: the champion of push-indicator is verified and predicts physically plausible outcomes."""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from service.model.loaded_model import LoadedModel
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext
from service.registry.loading import load_version
from service.registry.registry import Registry

Array = npt.NDArray[np.float64]
PUSHER_DISTANCE_M = 0.08  # the start of a push of the benchmark, from the centre of the object
PUSH_LENGTH_M = 0.05
BEARINGS_RAD = np.linspace(-math.pi, math.pi, 24, endpoint=False) + 0.05
# Objects of every shape, with no, one and two weights, from the held-out half of the published division.
HELD_OUT = ("1a1a3a3a", "1a2a4a3a", "3a3a3a4a", "1a4a1a4a", "1a2c4a4a", "2b3a3b4a", "2B2b3a3a", "1b2B1a4a", "2c4a4a4a")


@pytest.fixture(scope="module")
def champion(project_root: Path) -> LoadedModel:
    """Load the champion of push-indicator with all checks of the service."""
    registry = Registry(project_root / "models")
    version = registry.resolve(ModelReference.parse("push-indicator"))
    return load_version(registry, OnnxPredictor, "push-indicator", version)


def towards_the_centre(bearings_rad: Array) -> Array:
    """Return pushes from these bearings straight at the centre of the object, (n, 3)."""
    angle = bearings_rad + math.pi
    start = PUSHER_DISTANCE_M * np.stack([np.cos(bearings_rad), np.sin(bearings_rad)], axis=1)
    return np.column_stack([start, np.arctan2(np.sin(angle), np.cos(angle))])


def means(model: LoadedModel, objects: list[ObjectContext], pushes: Array) -> Array:
    """Predict the means of every push of every object, (objects, pushes, 3)."""
    context = np.stack([thing.indicator() for thing in objects])
    index = np.repeat(np.arange(len(objects)), len(pushes))
    mean, *_ = model.predictor.predict(np.tile(pushes, (len(objects), 1)).astype(np.float32), (context,), index)
    return mean.astype(np.float64).reshape(len(objects), len(pushes), 3)


def test_the_first_version_has_the_method_and_data_of_its_card(project_root: Path) -> None:
    """Version 1 is FCN + CM + L2Reg after 3000 epochs on 200 x 250 pushes, which its card declares as simulated."""
    version = Registry(project_root / "models").read("push-indicator", 1)
    manifest = version.manifest
    assert (manifest.method, manifest.context_kind) == ("FCN + CM + L2Reg", ContextKind.INDICATOR)
    assert manifest.recipe["epochs"] == 3000
    assert (manifest.data.train_objects, manifest.data.train_pushes) == (200, 50_000)
    assert "simulated" in manifest.data.source
    assert "simulated" in version.card


def test_a_push_at_the_object_moves_it_away_from_the_pusher(champion: LoadedModel) -> None:
    """A push at the centre, from any bearing, moves every object forward, and less than the pusher moves.

    No tolerance is needed. The pusher moves 50 mm and the simulated objects moved 12 to 44 mm, so both limits are
    further away than the model's own error (RMSE of 2 to 3 mm in position).
    """
    pushes = towards_the_centre(BEARINGS_RAD)
    mean = means(champion, [ObjectContext.from_descriptor(name) for name in HELD_OUT], pushes)
    forward = mean[..., 0] * np.cos(pushes[:, 2]) + mean[..., 1] * np.sin(pushes[:, 2])
    assert (forward > 0.0).all()
    assert (np.hypot(mean[..., 0], mean[..., 1]) < PUSH_LENGTH_M).all()


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_rotating_push_and_object_rotates_the_outcome(champion: LoadedModel, quarter_turns: int) -> None:
    """Rotating push and object together rotates the outcome, within the model's own error.

    The network does not have this symmetry built in, so each of the two predictions has an error of its own. The rms
    difference of two predictions is at most sqrt(2) times the model's held-out RMSE, in the same normalised units.
    """
    manifest = champion.manifest
    turn = quarter_turns * math.pi / 2.0
    objects = [ObjectContext.from_descriptor(name) for name in HELD_OUT]
    straight = means(champion, objects, towards_the_centre(BEARINGS_RAD))
    turned = means(
        champion, [thing.turned(quarter_turns) for thing in objects], towards_the_centre(BEARINGS_RAD + turn)
    )
    expected_x = math.cos(turn) * straight[..., 0] - math.sin(turn) * straight[..., 1]
    expected_y = math.sin(turn) * straight[..., 0] + math.cos(turn) * straight[..., 1]
    difference = turned - np.stack([expected_x, expected_y, straight[..., 2]], axis=-1)
    rms = math.sqrt(float(np.mean((difference / np.array(manifest.normalisation.output_std)) ** 2)))
    assert rms < math.sqrt(2.0) * manifest.metrics["different-objects"].rmse


def test_every_push_of_a_grid_has_a_positive_finite_std(champion: LoadedModel) -> None:
    """Every push of a grid over the permitted range has a finite mean, a positive std and an angle of at most pi."""
    axis = np.linspace(-1.0, 1.0, 21)
    grid = np.stack(np.meshgrid(axis, axis, np.linspace(-math.pi, math.pi, 17)), axis=-1).reshape(-1, 3)
    context = ObjectContext.from_descriptor("1a2C3b4a").indicator()[None]
    mean, std, _ = champion.predictor.predict(grid.astype(np.float32), (context,), np.zeros(len(grid), dtype=np.int64))
    assert np.isfinite(mean).all()
    assert (std > 0.0).all()
    assert (np.abs(mean[:, 2]) <= np.float32(math.pi)).all()
