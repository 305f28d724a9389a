"""A query predicts with one model: it checks the kind of contexts, and wraps angles."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from service.errors import ContextKindError
from service.inference.loaded_models import LoadedModels
from service.inference.query import Answer, ContextBatch, Query, Warnings, predict
from service.model.reference import ModelReference
from service.model.tensors import ContextKind, FloatArray, Gaussians, GraphSize, IndexArray
from service.observability.timings import Timings, collect_timings
from service.pushing.contexts import ObjectContext
from tests.fakes import SMALL, STD, fake_models, predict_push

CHAMPION = ModelReference.parse("push-indicator")
OBJECT = ObjectContext.from_descriptor("1a2b3c4a")
NO_CONTEXT = ContextBatch(ContextKind.NONE, (), None, "body.context")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Return loaded fake models."""
    return fake_models(tmp_path_factory.mktemp("models"))[1]


def test_a_push_is_predicted(models: LoadedModels) -> None:
    """The predictor gets pose and context, and the angle of its mean is wrapped."""
    (x_m, _, angle_rad), std = predict_push(models.snapshot.find(CHAMPION), (-0.08, 0.02, 0.0), OBJECT)
    turned = 8.0 - 6.283185307179586  # eight ones in an indicator
    assert x_m == pytest.approx(0.008)
    assert angle_rad == pytest.approx(turned, abs=1e-6)
    assert std == pytest.approx(list(STD))


def test_the_context_must_be_of_the_kind_of_the_model(models: LoadedModels) -> None:
    """A context for a model that takes none, and no context for a model that takes one, are errors of the request."""
    with pytest.raises(ContextKindError, match="kind none"):
        predict_push(models.snapshot.find(CHAMPION), (0.0, 0.0, 0.0), None)
    with pytest.raises(ContextKindError, match="kind indicator"):
        predict_push(models.snapshot.find_default(ContextKind.NONE), (0.0, 0.0, 0.0), OBJECT)


@dataclass
class TurningPredictor:
    """A predictor whose means have given angles."""

    angles: list[float]
    size: GraphSize = SMALL

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """Return the given angles."""
        mean = np.zeros((len(self.angles), 3), dtype=np.float32)
        mean[:, 2] = self.angles
        return Gaussians(mean, np.ones_like(mean))


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        ([0.5], [0.5]),
        ([4.0], [4.0 - 2 * math.pi]),
        ([0.5, -4.0], [0.5, 2 * math.pi - 4.0]),
        ([math.pi], [math.pi]),
        ([-math.pi], [-math.pi]),
        ([3 * math.pi, 1.0], [math.pi, 1.0]),
    ],
    ids=["inside", "one outside", "a row outside", "pi", "minus pi", "three half turns"],
)
def test_angles_of_means_are_wrapped(models: LoadedModels, angles: list[float], expected: list[float]) -> None:
    """Every angle lies within float64's -pi to pi, though float32's pi is beyond it."""
    model = replace(models.snapshot.find_default(ContextKind.NONE), predictor=TurningPredictor(angles))
    mean, *_ = predict(model, np.zeros((len(angles), 3), dtype=np.float32), NO_CONTEXT)
    assert np.cos(mean[:, 2]) == pytest.approx(np.cos(expected), abs=1e-6)
    assert np.abs(mean[:, 2]) == pytest.approx(np.abs(expected), abs=1e-6)
    assert (np.abs(mean[:, 2].astype(np.float64)) <= math.pi).all()


def test_a_wrong_kind_of_context_names_its_field(models: LoadedModels) -> None:
    """The error has the field of the request that gave the contexts."""
    contexts = ContextBatch(ContextKind.NONE, (), None, "body.contexts")
    with pytest.raises(ContextKindError, match=r"^body\.contexts: received kind none"):
        predict(models.snapshot.find(CHAMPION), np.zeros((1, 3), dtype=np.float32), contexts)


@dataclass(frozen=True, slots=True)
class TextQuery(Query):
    """A query whose answer is the number of pushes as text."""

    def encode(self, found: Gaussians, warnings: Warnings) -> Answer:
        """See ``Query.encode``."""
        return Answer(b"%d" % len(found.mean), headers=((b"content-type", b"text/plain"),))


def test_a_query_is_predicted_encoded_and_timed(models: LoadedModels) -> None:
    """An answer has the encoded prediction with its length, and the time in the runtime is recorded."""
    timings: Timings = []
    collect_timings(timings)
    model = models.snapshot.find_default(ContextKind.NONE)
    answer = TextQuery(model, np.zeros((3, 3), dtype=np.float32), NO_CONTEXT, ()).answer()
    assert answer.head() == ((b"content-type", b"text/plain"), (b"content-length", b"1"))
    assert answer.content == b"3"
    assert [phase for phase, _ in timings] == ["inference"]
