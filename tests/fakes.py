"""Fakes: predictors without onnxruntime, and registries of small but complete versions."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event, Semaphore

import numpy as np

from service.errors import BrokenModelError, PredictionError
from service.inference.loaded_models import LoadedModels
from service.inference.query import FIRST_CONTEXT, ContextBatch, predict
from service.model.loaded_model import LoadedModel
from service.model.manifest import Calibration, DataRecord, Manifest, Metrics, NormalisationRecord, SelfCheck
from service.model.self_check import flattened
from service.model.tensors import ContextKind, FloatArray, Gaussians, GraphSize, IndexArray, Tensor
from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.onnx_interface import OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from service.registry.registry import Registry

NO_KEYS = Path(__file__).parent / "data" / "no_keys.txt"
STD = (0.001, 0.002, 0.03)
BROKEN = b"broken"  # a model that the fake factory refuses
LYING = b"lying"  # a model that loads and fails its self-check
FAILING = b"failing"  # a model that passes its self-check and raises PredictionError on every other push
BUGGY = b"buggy"  # a model that passes its self-check and raises ZeroDivisionError on every other push
SMALL = GraphSize(1, 1)
CHECKED_PUSH = [-0.08, 0.0, 0.0]
Gaussian = tuple[list[float], list[float]]


class Panic(BaseException):
    """A panic of a library in native code. As there, it does not derive from ``Exception``."""


@dataclass
class FakePredictor:
    """A predictor whose mean is -0.1 times the pusher pose. With a context, the angle is the sum of its values.

    Attributes:
        has_domain: whether it tells how unfamiliar a push is.
        calls: pushers of each call, (n, 3).
        contexts: number of contexts of each call that had some.
        size: size of the graph that it pretends to run.
    """

    model: bytes
    takes_context: bool
    has_domain: bool = False
    calls: list[FloatArray] = field(default_factory=list)
    contexts: list[int] = field(default_factory=list)
    size: GraphSize = SMALL

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``service.model.predictor.Predictor``."""
        self.calls.append(pusher)
        if contexts:
            self.contexts.append(len(contexts[0]))
        if self.model == FAILING and not is_checked(pusher):
            raise PredictionError("the fake fails")
        if self.model == BUGGY and not is_checked(pusher):
            raise ZeroDivisionError("the fake has a bug")
        mean = np.asarray(-pusher[:, :3] / 10.0, dtype=np.float32)
        if self.takes_context and contexts and context_index is not None:
            sums = [tensor.reshape(len(tensor), -1).sum(axis=1) for tensor in contexts]
            mean[:, 2] = np.sum(sums, axis=0)[context_index]
        if self.model == LYING:
            mean = mean + np.float32(1.0)
        std = np.tile(np.array(STD, dtype=np.float32), (len(pusher), 1))
        return Gaussians(mean, std, np.full((len(mean), 2), 0.5, dtype=np.float32) if self.has_domain else None)


def is_checked(pusher: FloatArray) -> bool:
    """Return whether these are the pushes of a self-check."""
    return bool(pusher[0, :3].tolist() == np.array(CHECKED_PUSH, dtype=np.float32).tolist())


@dataclass
class Gate:
    """A gate that blocks every prediction but self-checks until it is opened.

    Attributes:
        reached: released once per blocked prediction.
        opened: set by a test to let all predictions continue.
    """

    reached: Semaphore = field(default_factory=lambda: Semaphore(0))
    opened: Event = field(default_factory=Event)

    def load(self, model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> "HeldPredictor":
        """Create a predictor. See ``service.model.predictor.PredictorFactory``."""
        return HeldPredictor(model, len(inputs) > 1, len(outputs) > 2, gate=self)


@dataclass
class HeldPredictor(FakePredictor):
    """A predictor that answers once its gate is open."""

    gate: Gate = field(default_factory=Gate)

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``service.model.predictor.Predictor``."""
        if not is_checked(pusher):
            self.gate.reached.release()
            self.gate.opened.wait()
        return super().predict(pusher, contexts, context_index)


def load_fake(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> FakePredictor:
    """Create a predictor. See ``service.model.predictor.PredictorFactory``.

    Raises:
        BrokenModelError: the model is ``BROKEN``.
    """
    if model == BROKEN:
        raise BrokenModelError("model.onnx: the fake refuses it")
    return FakePredictor(model, len(inputs) > 1, len(outputs) > 2)


def draft_manifest(name: str = "push-indicator", kind: ContextKind = ContextKind.INDICATOR) -> Manifest:
    """Create a manifest whose self-check holds the answer of ``FakePredictor``."""
    inputs = expected_inputs(kind)
    pusher = [CHECKED_PUSH + [0.05] * (kind is ContextKind.SHAPE)]
    contexts = tuple(np.zeros((1, *map(int, tensor.shape[1:])), dtype=np.float32) for tensor in inputs[1:-1])
    for tensor in contexts[:1]:
        tensor.reshape(-1)[:3] = 1.0
    mean, std, _ = FakePredictor(b"", kind is not ContextKind.NONE).predict(
        np.array(pusher, dtype=np.float32), contexts, np.zeros(1, dtype=np.int64)
    )
    return Manifest(
        name=name,
        version=1,
        created="2026-11-22T00:00:00+00:00",
        method="FCN" if kind is ContextKind.NONE else "FCN + CM",
        context_kind=kind,
        inputs=inputs,
        outputs=OUTPUTS_WITH_UNFAMILIARITY if kind in (ContextKind.SHAPE, ContextKind.SUPPORT) else OUTPUTS,
        normalisation=NormalisationRecord([0.0] * 3, [1.0] * 3, [0.0] * 3, [1.0] * 3),
        image_convention=None,
        recipe={"epochs": 1, "seed": 0},
        data=DataRecord("fake pushes", "0" * 64, "different-objects", 2, 20, 1, 10),
        code_version="0.0.0",
        metrics={"different-objects": Metrics(0.5, 0.5, 10.96, 1.0)},
        calibration={"different-objects": Calibration("none", 0.5, 0.9, 0.95, [0.001, 0.002, 0.03])},
        self_check=SelfCheck(pusher, flattened(contexts), [0], mean.tolist(), std.tolist(), 1e-4),
        files={},
    )


def publish_fake(
    registry: Registry,
    name: str = "push-indicator",
    kind: ContextKind = ContextKind.INDICATOR,
    model: bytes = b"fine",
    alias: str | None = "champion",
) -> int:
    """Publish a fake model, point an alias at it and return its version."""
    version = registry.publish(draft_manifest(name, kind), model, f"# {name}\n").version
    if alias is not None:
        registry.point_alias(name, alias, version)
    return version


def fake_models(root: Path) -> tuple[Registry, LoadedModels]:
    """Create a registry with an indicator model and a model without context, and load its models."""
    registry = Registry(root)
    publish_fake(registry)
    publish_fake(registry, "push-none", ContextKind.NONE)
    models = LoadedModels(registry, load_fake)
    models.refresh()
    return registry, models


def all_fake_models(folder: Path) -> tuple[Registry, LoadedModels]:
    """Create a registry with a model of each context kind and a failing model, and load its models."""
    registry, models = fake_models(folder)
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    publish_fake(registry, "push-shape", ContextKind.SHAPE)
    publish_fake(registry, "push-anp", ContextKind.SUPPORT)
    publish_fake(registry, "push-failing", model=FAILING)
    models.refresh()
    return registry, models


def predict_push(
    model: LoadedModel, pusher: Sequence[float], context: ObjectContext | VisualContext | None
) -> Gaussian:
    """Predict one push as a query does. Return mean and std, three numbers each, in m, m, rad in the object frame."""
    kind = ContextKind.NONE if context is None else context.kind
    tensors, index = ((), None) if context is None else ((context.tensor()[None],), FIRST_CONTEXT)
    batch = ContextBatch(kind, tensors, index, "context")
    mean, std, _ = predict(model, np.array([pusher], dtype=np.float32), batch)
    return mean[0].tolist(), std[0].tolist()
