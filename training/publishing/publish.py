"""Publication of a fitted network: measure, export, check parity, and publish a version.

It is the trainer's last step, and the only one that writes to a registry. Before a version becomes visible, onnxruntime
must agree with torch on plausible and on extreme inputs.
"""

import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Final

import service
from service.errors import DataError, PublishError
from service.model.manifest import Calibration, DataRecord, Manifest, Metrics, NormalisationRecord, SelfCheck
from service.model.predictor import OnnxPredictor
from service.model.self_check import flattened
from service.model.tensors import ContextKind
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from service.registry.registry import Registry
from training.fitting.evaluation import COVERAGE_LEVELS, Evaluation, evaluate
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PushNetwork
from training.omnipush.published import Split, published_normalisation
from training.omnipush.pushes import Pushes
from training.publishing.card import render_card
from training.publishing.onnx_export import export_onnx
from training.publishing.parity import check_parity
from training.publishing.parity_inputs import plausible_batch

SELF_CHECK_TOLERANCE: Final = 1e-4  # a tenth of a millimetre, across processors and versions of the runtime


def publish(
    recipe: Recipe,
    network: PushNetwork | NeuralProcess,
    pushes: Pushes,
    registry: Registry,
    image_convention: str | None = None,
    measured: tuple[Recipe, PushNetwork | NeuralProcess] | None = None,
) -> Manifest:
    """Measure, export, check and publish a fitted network as the next version of the recipe's model.

    Args:
        recipe: of the network.
        network: the fitted network.
        pushes: of all objects of the recipe's split.
        registry: receives the version.
        image_convention: of the views that a visual model was trained on.
        measured: for a recipe that holds no object out, the same recipe with a set-up that does, and its network. The
            figures of the version are then theirs.

    Raises:
        PublishError: the graph disagrees with torch, or the disk refused. No version became visible.
        DataError: the data lack objects of the split, the method is not served, or no object was held out.
    """
    kind, split = recipe.context_kind, recipe.split()
    measured_recipe, measured_network = measured or (recipe, network)
    set_up = _measured_split(recipe, measured_recipe)
    if not isinstance(network, PushNetwork) or set_up.test_surface is not None:
        raise DataError(
            f"{recipe.method} on {split.name} is not published: a served model is zero-shot, and measured on the "
            "surface it was trained on; publish another method, or a run of another set-up"
        )
    train, held_out = pushes.select(split.train), pushes.select(set_up.test)
    samples = Samples.of(held_out, kind)
    found = evaluate(measured_network, samples)
    if not math.isfinite(found.nll):
        raise PublishError("the network's held-out figures are not finite; no version was published")
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


def _measured_split(recipe: Recipe, measured: Recipe) -> Split:
    """Return the split on which a version is measured.

    Raises:
        DataError: the measured run is of another recipe, or it held no object out.
    """
    if replace(measured, set_up=recipe.set_up) != recipe:
        raise DataError(f"the run of {measured.name} that was measured is of another recipe; only set_up may differ")
    set_up = measured.split()
    if not set_up.test:
        raise DataError(
            f"{recipe.name} was trained on every object, so it has no held-out objects to measure; train the same "
            "recipe with --set-up different-objects, and publish with --measured and the folder of that run"
        )
    return set_up


def _calibration(found: Evaluation) -> Calibration:
    coverage_50, coverage_90, coverage_95 = (found.coverage[level] for level in COVERAGE_LEVELS)
    return Calibration("none", coverage_50, coverage_90, coverage_95, list(found.sharpness))


def _self_check(model: bytes, kind: ContextKind, samples: Samples) -> SelfCheck:
    """Return a small batch with the graph's own outputs, which every load compares with. Gates turn its views."""
    batch = plausible_batch(kind, pushes=4, objects=2, seed=4)
    if kind is ContextKind.VISUAL:  # of real objects: a network learns the symmetry of those
        batch = replace(batch, contexts=(samples.context[:2].numpy(),))
    mean, std, _ = OnnxPredictor(model, expected_inputs(kind), OUTPUTS).predict(
        batch.pusher, batch.contexts, batch.context_index
    )
    return SelfCheck(
        pusher=batch.pusher.tolist(),
        context=flattened(batch.contexts),
        context_index=batch.context_index.tolist(),
        mean=mean.tolist(),
        std=std.tolist(),
        tolerance=SELF_CHECK_TOLERANCE,
    )
