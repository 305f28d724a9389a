"""A served model as the model of one object: its outcomes are those of predictions."""

from pathlib import Path

import numpy as np
import pytest

from service.api.v1.object_contexts import encode_context
from service.inference.loaded_models import LoadedModels
from service.inference.object_model import ObjectModel
from service.inference.query import predict
from service.model.predictor import OnnxPredictor
from service.registry.registry import Registry
from service.schemas.contexts import ContextBody
from service.schemas.shapes import OUTLINE_EXAMPLE
from service.validity.codes import WarningCode

PUSHES = np.array([[-0.1, 0.0, 0.0, 0.05], [-0.1, 0.3, 0.0, 0.05], [0.01, 0.0, 0.0, 0.05]])
CONTEXTS = {
    "shape": ContextBody(outline=OUTLINE_EXAMPLE),
    "indicator": ContextBody(descriptor="1a2b3c4a"),
    "none": None,
}


@pytest.fixture(scope="module")
def models(project_root: Path) -> LoadedModels:
    """Load the models that ship."""
    found = LoadedModels(Registry(project_root / "models"), OnnxPredictor)
    found.refresh()
    return found


def of_kind(models: LoadedModels, kind: str) -> ObjectModel:
    """Return the champion for a kind of context with an example of it."""
    contexts = encode_context(CONTEXTS[kind])
    return ObjectModel(models.snapshot.find_default(contexts.kind), contexts)


@pytest.mark.parametrize("kind", CONTEXTS)
def test_outcomes_are_the_models_predictions(models: LoadedModels, kind: str) -> None:
    """Mean and std are those of the query of every route, whatever the number of pushes."""
    asked = of_kind(models, kind)
    found = asked(PUSHES[:1])
    rows = PUSHES[:1].astype(np.float32)
    plain = predict(asked.model, rows if asked.knows_lengths else rows[:, :3], asked.contexts)
    assert found.mean == pytest.approx(plain.mean)
    assert found.std == pytest.approx(plain.std)
    assert len(asked(np.repeat(PUSHES, 700, axis=0)).mean) == 2100


@pytest.mark.parametrize("kind", ["shape", "indicator"])
def test_misses_and_starts_inside_are_found_where_the_form_is_known(models: LoadedModels, kind: str) -> None:
    """The second push passes the object, and the third starts in its middle."""
    found = of_kind(models, kind)(PUSHES)
    assert found.misses.tolist() == [False, True, False]
    assert found.inside.tolist() == [False, False, True]


def test_pushes_that_the_version_does_not_vouch_for_are_found(models: LoadedModels) -> None:
    """Half a metre away no object of Omnipush was pushed."""
    far = np.array([[-0.5, 0.0, 0.0, 0.05], [-0.09, 0.0, 0.0, 0.05]])
    assert of_kind(models, "indicator")(far).unfamiliar.tolist() == [True, False]


def test_warnings_of_the_object_are_not_those_of_a_push(models: LoadedModels) -> None:
    """An angle in degrees is told, and an object as published has no warning."""
    asked = of_kind(models, "indicator")
    assert asked.object_warnings(()) == ()
    (found,) = asked.object_warnings((("pushes", (90.0,)),))
    assert found.code is WarningCode.ANGLE_LOOKS_LIKE_DEGREES


def test_a_shape_far_from_the_origin_of_its_frame_is_the_same_object(models: LoadedModels) -> None:
    """Its centre moves alike with the same spread, and the pose of its frame has the deviations of a prediction."""
    away = np.array([0.5, -0.3])
    near = of_kind(models, "shape")(PUSHES[:1])
    contexts = encode_context(ContextBody(outline=(np.array(OUTLINE_EXAMPLE) + away).tolist()))
    asked = ObjectModel(models.snapshot.find_default(contexts.kind), contexts)
    pushes = PUSHES[:1] + np.append(away, [0.0, 0.0])
    found = asked(pushes)
    assert found.centre_m == pytest.approx(away, abs=1e-6)
    assert found.std == pytest.approx(near.std, rel=1e-3)
    assert found.mean[0, 2] == pytest.approx(near.mean[0, 2], abs=1e-5)
    plain = predict(asked.model, pushes.astype(np.float32), asked.contexts)
    assert found.mean == pytest.approx(plain.mean, abs=1e-5)
    assert found.frame_std() == pytest.approx(plain.std, rel=1e-2)
