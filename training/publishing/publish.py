"""Publication of a fitted network: measure, export, check parity, and publish a version.

It is the trainer's last step, and the only one that writes to a registry. Before a version becomes visible, onnxruntime
must agree with torch on plausible and on extreme inputs.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Final

import torch

import service
from service.errors import DataError, PublishError
from service.model.manifest import (
    Calibration,
    DataRecord,
    Manifest,
    Metrics,
    NormalisationRecord,
    Rival,
    SelfCheck,
    Validity,
)
from service.model.predictor import OnnxPredictor
from service.model.self_check import flattened
from service.model.tensors import ContextKind
from service.model.tensors import Tensor as TensorRecord
from service.pushing.onnx_interface import expected_inputs
from service.pushing.poses import PUSH_LENGTH_M
from service.registry.registry import Registry
from training.fitting.bands import calibrated
from training.fitting.evaluation import Predictions
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples
from training.networks.neural_process import NeuralProcess
from training.networks.omnipush_domain import OmnipushDomain
from training.networks.push_network import PushNetwork
from training.omnipush.published import Split, published_normalisation
from training.omnipush.pushes import Pushes
from training.publishing.card import render_card
from training.publishing.onnx_export import export_onnx, graph_outputs
from training.publishing.parity import check_parity
from training.publishing.parity_inputs import Batch, plausible_batch
from training.publishing.rivals import calibration_of, measured_name, metrics_of, rivals_of

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
    set_up = measured_split(recipe, measured_recipe)
    if (
        not isinstance(network, PushNetwork)
        or not isinstance(measured_network, PushNetwork)
        or set_up.test_surface is not None
    ):
        raise DataError(
            f"{recipe.method} on {split.name} is not published: a served model takes a context, or is measured "
            "without one, on the surface it was trained on; publish a run of another recipe (ANP: push-anp)"
        )
    train, held_out = pushes.select(split.train), pushes.select(set_up.test)
    samples = Samples.of(held_out, kind)
    found = calibrated(measured_network, samples)
    figures = {measured_name(set_up, views): each for views, each in found.predictions.items()}
    metrics = finite_metrics(figures)
    domain = domain_of(train, kind)
    model = export_onnx(network, kind, domain, found.factor)
    parity = check_parity(network, model, kind, domain, found.factor)
    batch = plausible_batch(kind, pushes=4, objects=2, seed=4)
    if kind is ContextKind.VISUAL:  # of real objects: a network learns the symmetry of those, and gates turn its views
        batch = replace(batch, contexts=(samples.context[:2].numpy(),))
    draft = draft_of(
        recipe,
        graph_outputs(domain),
        data=data_record(pushes, split, train, held_out),
        metrics=metrics,
        calibration={name: calibration_of(each, found.factor) for name, each in figures.items()},
        self_check=self_check_of(model, kind, graph_outputs(domain), batch),
        validity=_validity(domain),
        image_convention=image_convention,
        rivals=rivals_of(registry, recipe.name, set_up, samples),
    )
    return registry.publish(draft, model, render_card(draft, figures, parity))


def finite_metrics(figures: Mapping[str, Predictions]) -> dict[str, Metrics]:
    """Return error and likelihood of held-out predictions by name.

    Raises:
        PublishError: a likelihood is not finite, as that of a network that diverged.
    """
    metrics = {name: metrics_of(each) for name, each in figures.items()}
    if not all(math.isfinite(each.nll) for each in metrics.values()):
        raise PublishError("the network's held-out figures are not finite; no version was published")
    return metrics


def draft_of(
    recipe: Recipe,
    outputs: tuple[TensorRecord, ...],
    *,
    data: DataRecord,
    metrics: dict[str, Metrics],
    calibration: dict[str, Calibration],
    self_check: SelfCheck,
    validity: Validity,
    image_convention: str | None = None,
    rivals: dict[str, Rival] | None = None,
) -> Manifest:
    """Return the manifest of a recipe's next version, without its number and the digests of its files."""
    known = vars(published_normalisation())
    return Manifest(
        name=recipe.name,
        version=1,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        method=recipe.method,
        context_kind=recipe.context_kind,
        inputs=expected_inputs(recipe.context_kind),
        outputs=outputs,
        normalisation=NormalisationRecord(**{name: list(value) for name, value in known.items()}),
        image_convention=image_convention,
        recipe=recipe.record(),
        data=data,
        code_version=service.__version__,
        metrics=metrics,
        calibration=calibration,
        self_check=self_check,
        files={},
        validity=validity,
        rivals=rivals,
    )


def self_check_of(model: bytes, kind: ContextKind, outputs: tuple[TensorRecord, ...], batch: Batch) -> SelfCheck:
    """Return a small batch with the graph's own outputs, which every load compares with."""
    predictor = OnnxPredictor(model, expected_inputs(kind), outputs)
    mean, std, _ = predictor.predict(batch.pusher, batch.contexts, batch.context_index)
    return SelfCheck(
        pusher=batch.pusher.tolist(),
        context=flattened(batch.contexts),
        context_index=batch.context_index.tolist(),
        mean=mean.tolist(),
        std=std.tolist(),
        tolerance=SELF_CHECK_TOLERANCE,
    )


def domain_of(train: Pushes, kind: ContextKind) -> OmnipushDomain:
    """Return the domain of training pushes and of the contexts of their objects."""
    samples = Samples.of(train, kind)
    contexts = samples.context[:, None] if samples.views is None else samples.views
    if kind is ContextKind.INDICATOR:
        contexts = samples.context
    pushers = torch.from_numpy(train.pushers[train.valid > 0])
    return OmnipushDomain(kind).fit(pushers, contexts).eval()


def _validity(domain: OmnipushDomain) -> Validity:
    ranges = {name: (low, high) for name, (low, high) in domain.ranges().items()}
    _, furthest_m = ranges["start_distance_m"]
    return Validity(
        {**ranges, "length_m": (PUSH_LENGTH_M, PUSH_LENGTH_M)},
        f"pushes of 50 mm that start between touch and {1000 * furthest_m:.0f} mm from the centre of an object of "
        "Omnipush, in any direction, misses included; objects have at most two weights",
    )


def data_record(pushes: Pushes, split: Split, train: Pushes, held_out: Pushes) -> DataRecord:
    """Return the record of the data of a run."""
    return DataRecord(
        source=pushes.source,
        sha256=pushes.digest,
        split=split.name,
        train_objects=len(train.descriptors),
        train_pushes=train.count,
        held_out_objects=len(held_out.descriptors),
        held_out_pushes=held_out.count,
    )


def measured_split(recipe: Recipe, measured: Recipe) -> Split:
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
