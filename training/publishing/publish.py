"""Torch to ONNX, parity checked, published: the trainer's last step and the only one that touches the registry.

The graph takes and gives SI units, so the published normalisation is inside it; contexts are encoded once per object
and gathered per push. Before anything is published, onnxruntime must agree with torch on random and on extreme inputs.
"""

import logging
import math
import warnings
from dataclasses import replace
from datetime import UTC, datetime
from typing import Final

import numpy as np
import onnx
import torch
from torch import Tensor, nn

import service
from service.errors import DataError, PublishError
from service.model.manifest import (
    OUTPUTS,
    Calibration,
    DataRecord,
    Manifest,
    Metrics,
    NormalisationRecord,
    SelfCheck,
    expected_inputs,
)
from service.model.predictor import OnnxPredictor
from service.pushing.contexts import ContextKind
from service.registry.registry import Registry
from training.fitting.evaluation import COVERAGE_LEVELS, Evaluation, evaluate
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples
from training.networks.angles import wrapped
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PushNetwork
from training.omnipush.published import Split, published_normalisation
from training.omnipush.pushes import Pushes
from training.publishing.card import render_card
from training.publishing.parity_inputs import Batch, extreme_batch, feed, probe_batch

OPSET: Final = 18
# Torch and onnxruntime sum in another order: float32 leaves a few units in the sixth digit. One tolerance for both
# outputs, absolute in SI units and relative beside it for inputs far outside of anything trained on.
PARITY_TOLERANCE: Final = 1e-5
PARITY_RELATIVE: Final = 1e-4
SELF_CHECK_TOLERANCE: Final = 1e-4  # across processors and runtime versions: a tenth of a millimetre


class ServedNetwork(nn.Module):
    """A fitted network with SI units in and out, as the contract's ONNX interface has it."""

    def __init__(self, network: PushNetwork) -> None:
        super().__init__()
        self.network = network
        known = published_normalisation()
        self.input_mean, self.input_std, self.output_mean, self.output_std = (
            nn.Buffer(torch.tensor(value, dtype=torch.float32))
            for value in (known.input_mean, known.input_std, known.output_mean, known.output_std)
        )

    def forward(
        self, pusher: Tensor, context: Tensor | None = None, context_index: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Mean and std (n, 3) of pushes (n, 3) of the objects ``context[context_index]``."""
        mean, std = self.unwrapped(pusher, context, context_index)
        return wrap_last(mean), std

    def unwrapped(
        self, pusher: Tensor, context: Tensor | None = None, context_index: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """The same with the angle as the network gives it: rounding is in proportion to this one."""
        conditioning = None
        if context is not None and context_index is not None:
            conditioning = self.network.conditioning(context)  # (g, 256): once per object
            conditioning = None if conditioning is None else conditioning[context_index]  # (n, 256)
        mean, log_std = self.network.gaussian((wrap_last(pusher) - self.input_mean) / self.input_std, conditioning)
        return mean * self.output_std + self.output_mean, torch.exp(log_std) * self.output_std


def wrap_last(pose: Tensor) -> Tensor:
    """Poses (n, 3) with their angle in (-pi, pi]."""
    position, angle = torch.split(pose, [2, 1], dim=-1)
    return torch.cat([position, wrapped(angle)], dim=-1)


def export_onnx(network: PushNetwork, kind: ContextKind) -> bytes:
    """The network as an ONNX graph in one file, without a trace of the machine that made it."""
    served = ServedNetwork(network).eval()
    example = probe_batch(kind, pushes=3, objects=2)
    arguments = tuple(torch.from_numpy(array) for array in feed(example, kind))
    names = [tensor.name for tensor in expected_inputs(kind)]
    pushes, objects = torch.export.Dim("n"), torch.export.Dim("g")
    free = {"pusher": {0: pushes}, "context": {0: objects}, "context_index": {0: pushes}}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of operators that are not installed or used
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what torch deprecates in itself; parity is checked below
        program = torch.onnx.export(
            served,
            arguments,
            input_names=names,
            output_names=[tensor.name for tensor in OUTPUTS],
            dynamic_shapes={name: free[name] for name in names},
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise PublishError("torch gave no ONNX program")
    model = program.model_proto
    strip_origin(model)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def strip_origin(model: onnx.ModelProto) -> None:
    """Remove source lines and paths of the exporting machine that torch writes into the graph."""
    del model.metadata_props[:]
    model.doc_string = ""
    model.graph.doc_string = ""
    for part in (model.graph, *model.graph.node, *model.graph.value_info, *model.graph.input, *model.graph.output):
        del part.metadata_props[:]
        part.doc_string = ""
    for tensor in model.graph.initializer:
        del tensor.metadata_props[:]
        tensor.doc_string = ""


def check_parity(network: PushNetwork, model: bytes, kind: ContextKind) -> float:
    """The largest difference between torch and onnxruntime on plausible pushes, in SI units; extreme ones agree too.

    Raises:
        PublishError: it is over the tolerance.
    """
    predictor, served = OnnxPredictor(model, kind), ServedNetwork(network).eval()

    def compare(batch: Batch) -> float:
        """The largest difference for this batch."""
        found = np.stack(predictor.predict(batch.pusher, batch.context, batch.context_index))
        arguments = [torch.from_numpy(array) for array in feed(batch, kind)]
        with torch.inference_mode():
            expected, size = (
                np.stack([tensor.numpy() for tensor in gaussian])
                for gaussian in (served(*arguments), served.unwrapped(*arguments))
            )
        difference = np.abs(found - expected)
        difference[0, :, 2] = np.minimum(difference[0, :, 2], 2.0 * math.pi - difference[0, :, 2])  # pi is -pi
        if (difference > PARITY_TOLERANCE + PARITY_RELATIVE * np.abs(size)).any():
            raise PublishError(f"onnxruntime differs from torch by {difference.max():.2e}; nothing was published")
        return float(difference.max())

    compare(extreme_batch(kind))
    return max(compare(probe_batch(kind, 1000, 37, seed=2)), compare(probe_batch(kind, 1, 1, seed=3)))


def publish(
    recipe: Recipe,
    network: PushNetwork | NeuralProcess,
    pushes: Pushes,
    registry: Registry,
    image_convention: str | None = None,
    measured: tuple[Recipe, PushNetwork | NeuralProcess] | None = None,
) -> Manifest:
    """Measure, export, check and publish a fitted network as the next version of the recipe's model.

    ``image_convention`` says how the views were taken that a visual model was trained on. Of a recipe that holds no
    object out, ``measured`` is the same recipe and its network on a set-up that does: the figures are theirs.

    Raises:
        PublishError: the graph disagrees with torch, or the disk refused; nothing became visible.
        DataError: the data lack objects of the split, the method is not one to serve, or nothing was held out.
    """
    kind, split = recipe.context_kind, recipe.split()
    judged, judge = (recipe, network) if measured is None else measured
    set_up = _measured_split(recipe, judged)
    if not isinstance(network, PushNetwork) or set_up.test_surface is not None:
        raise DataError(
            f"{recipe.method} on {split.name} is not published: a served model is zero-shot, and measured on the "
            "surface it was trained on; publish another method, or a run of another set-up"
        )
    train, held_out = pushes.select(split.train), pushes.select(set_up.test)
    samples = Samples.of(held_out, kind)
    found = evaluate(judge, samples)
    if not math.isfinite(found.nll):
        raise PublishError("the network's held-out figures are not finite; nothing was published")
    model = export_onnx(network, kind)
    parity = check_parity(network, model, kind)
    draft = Manifest(
        name=recipe.name,
        version=1,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        method=recipe.method,
        context_kind=kind,
        inputs=expected_inputs(kind),
        outputs=OUTPUTS,
        normalisation=NormalisationRecord(
            **{name: list(value) for name, value in vars(published_normalisation()).items()}
        ),
        image_convention=image_convention,
        recipe=recipe.record(),
        data=_data_record(pushes, split, train, held_out),
        code_version=service.__version__,
        metrics={set_up.name: Metrics(found.rmse, found.std, found.distance_mm, found.nll)},
        calibration={set_up.name: _calibration(found)},
        self_check=_self_check(model, kind, samples),
        files={},
    )
    return registry.publish(draft, model, render_card(draft, found, train, parity))


def _data_record(pushes: Pushes, split: Split, train: Pushes, held_out: Pushes) -> DataRecord:
    return DataRecord(
        source=pushes.source,
        sha256=pushes.digest,
        split=split.name,
        train_objects=len(train.descriptors),
        train_pushes=train.count,
        held_out_objects=len(held_out.descriptors),
        held_out_pushes=held_out.count,
    )


def _measured_split(recipe: Recipe, judged: Recipe) -> Split:
    """The set-up on which the figures of a version are measured, which must be of the same recipe."""
    if replace(judged, set_up=recipe.set_up) != recipe:
        raise DataError(f"the run of {judged.name} that was measured is of another recipe; only set_up may differ")
    set_up = judged.split()
    if not set_up.test:
        raise DataError(
            f"{recipe.name} was trained on every object, so no figure of its own would be honest; train the same "
            "recipe with --set-up different-objects, and publish with --measured and the folder of that run"
        )
    return set_up


def _calibration(found: Evaluation) -> Calibration:
    coverage_50, coverage_90, coverage_95 = (found.coverage[level] for level in COVERAGE_LEVELS)
    return Calibration("none", coverage_50, coverage_90, coverage_95, list(found.sharpness))


def _self_check(model: bytes, kind: ContextKind, samples: Samples) -> SelfCheck:
    """A small batch with the answers of the graph itself, for every later load; its views are turned by the gates."""
    batch = probe_batch(kind, pushes=4, objects=2, seed=4)
    if kind is ContextKind.VISUAL:  # of objects that exist: what symmetry a network learnt holds for those
        batch = replace(batch, context=samples.context[:2].numpy())
    mean, std = OnnxPredictor(model, kind).predict(batch.pusher, batch.context, batch.context_index)
    return SelfCheck(
        pusher=batch.pusher.tolist(),
        context=batch.context.reshape(len(batch.context), -1).tolist(),
        context_index=batch.context_index.tolist(),
        mean=mean.tolist(),
        std=std.tolist(),
        tolerance=SELF_CHECK_TOLERANCE,
    )
