"""Publication of a fitted network of shapes: measure, export, check parity, and publish a version."""

from dataclasses import replace
from typing import Final

import numpy as np
import torch

from service.errors import DataError
from service.model.manifest import Calibration, DataRecord, Manifest, Validity
from service.model.tensors import ContextKind
from service.pushing.onnx_interface import OUTPUTS_WITH_UNFAMILIARITY
from service.registry.registry import Registry
from training.fitting.evaluation import Predictions
from training.fitting.recipe import DIFFERENT_FAMILIES, Recipe
from training.fitting.shape_evaluation import LEVEL, Factor, ShapeFigures, evaluate_shapes
from training.fitting.shape_samples import ShapeSplit, draw_known, shape_batch, split_shapes
from training.networks.push_network import PushNetwork
from training.networks.shape_network import SMALL_M, ShapeDomain, ShapeNetwork
from training.publishing.onnx_export import export_module
from training.publishing.parity import check_shape_parity
from training.publishing.parity_inputs import plausible_batch
from training.publishing.publish import draft_of, finite_metrics, self_check_of
from training.publishing.rivals import calibration_of
from training.publishing.shape_card import render_shape_card
from training.tables.push_table import PushTable

_KIND: Final = ContextKind.SHAPE
_NOTE: Final = (
    "pushes of a rigid object of any outline on a plate, by a round tip, of which the centre of mass, the friction and "
    "the tip may be unknown"
)


def publish_shapes(
    recipe: Recipe,
    network: PushNetwork,
    table: PushTable,
    registry: Registry,
    measured: tuple[Recipe, PushNetwork] | None = None,
    scores: str = "",
) -> Manifest:
    """Measure, export, check and publish a fitted network of shapes as the next version of the recipe's model.

    Args:
        recipe: of the network.
        network: the fitted network.
        table: the pushes that it was trained on, and those of held-out objects.
        registry: receives the version.
        measured: for a recipe that is trained on all families, the same recipe with families held out, and its
            network. The figures of the version are then theirs, and the factor is its own.
        scores: text for the card on other data, such as recorded pushes.

    Raises:
        PublishError: the graph disagrees with torch, or the disk refused. No version became visible.
        DataError: the table lacks objects, or the measured run held no family out.
    """
    judged, judged_network = measured or (recipe, network)
    if judged.set_up != DIFFERENT_FAMILIES:
        raise DataError(
            f"{recipe.name} was trained on all families; fit the recipe without --set-up as well, and publish with "
            "--measured and the folder of that run"
        )
    split = split_shapes(table, recipe.set_up)
    judged_split = split_shapes(table, judged.set_up)
    figures = evaluate_shapes(judged_network, judged_split, judged.seed)
    factor = figures.factor if measured is None else evaluate_shapes(network, split, recipe.seed).factor
    metrics = finite_metrics(figures.predictions)
    domain = shape_domain(split.train, recipe.seed)
    served = ShapeNetwork(network, domain, factor.scale, factor.small).eval()
    model = export_module(served, _KIND, OUTPUTS_WITH_UNFAMILIARITY)
    parity = check_shape_parity(served, model)
    batch = plausible_batch(_KIND, pushes=4, objects=2, seed=4)
    draft = draft_of(
        recipe,
        OUTPUTS_WITH_UNFAMILIARITY,
        data=_data_record(table, recipe, split, judged_split, figures),
        metrics=metrics,
        calibration={name: _calibration(found, factor) for name, found in figures.predictions.items()},
        self_check=self_check_of(model, _KIND, OUTPUTS_WITH_UNFAMILIARITY, batch),
        validity=Validity({name: (low, high) for name, (low, high) in domain.ranges().items()}, _NOTE),
    )
    return registry.publish(draft, model, render_shape_card(draft, figures, parity, scores))


def shape_domain(table: PushTable, seed: int) -> ShapeDomain:
    """Return the domain of a table, with values of bodies as clients know them."""
    batch = shape_batch(table, draw_known(table, np.random.default_rng([seed, 26])))
    pusher, silhouette, _, _, body, index = batch.tensors()
    with torch.no_grad():
        return ShapeDomain().fit(pusher, silhouette, body, index).eval()


def _data_record(
    table: PushTable, recipe: Recipe, split: ShapeSplit, judged: ShapeSplit, figures: ShapeFigures
) -> DataRecord:
    held_out = [judged.held_out, *([] if judged.unseen is None else [judged.unseen])]
    return DataRecord(
        source=table.source,
        sha256=table.digest,
        split=recipe.set_up,
        train_objects=len(split.train.objects),
        train_pushes=split.train.count,
        held_out_objects=sum(len(part.objects) for part in held_out),
        held_out_pushes=sum(len(found.mean) for found in figures.predictions.values()),
    )


def _calibration(found: Predictions, factor: Factor) -> Calibration:
    method = (
        f"conformal factor of the joint region of {LEVEL:.0%}, of held-out objects; of objects smaller than "
        f"{SMALL_M:g} m it grows with their ratio to the power {factor.small:.3f}"
    )
    return replace(calibration_of(found, factor.scale), method=method)
