"""Publication of a fitted neural process, which is served with supports of 1 to 50 pushes as contexts."""

from dataclasses import replace
from typing import Final

import numpy as np
import torch

from service.errors import DataError
from service.model.manifest import Manifest, Rival, Validity
from service.model.predictor import Predictor
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import SupportContext
from service.pushing.onnx_interface import OUTPUTS_WITH_UNFAMILIARITY
from service.pushing.poses import PUSH_LENGTH_M
from service.registry.registry import Registry
from training.fitting.evaluation import Predictions, joined
from training.fitting.neural_process_step import SUPPORT_PUSHES, split_pushes
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples
from training.fitting.support_evaluation import COUNTS, DRAWS, evaluate_supports
from training.networks.neural_process import NeuralProcess, Points
from training.networks.omnipush_domain import SupportDomain
from training.omnipush.published import Split, published_normalisation
from training.omnipush.pushes import Pushes
from training.publishing.onnx_export import ServedProcess, export_module
from training.publishing.parity import check_served_parity
from training.publishing.parity_inputs import plausible_batch
from training.publishing.publish import data_record, draft_of, finite_metrics, measured_split, self_check_of
from training.publishing.rivals import calibration_of, metrics_of, named_predictors, normalised
from training.publishing.support_card import render_support_card

_KIND: Final = ContextKind.SUPPORT
_CHECKED: Final = (50, 20, 5, 1)  # pushes in the supports of the self-check, on which the gates are tried too
_NOTE: Final = (
    "pushes of 50 mm that start between touch and {:.0f} mm from the centre of an object of Omnipush, in any "
    "direction, misses included; the object is known by 1 to 50 such pushes, and has at most two weights"
)


def publish_supports(
    recipe: Recipe,
    network: NeuralProcess,
    pushes: Pushes,
    registry: Registry,
    measured: tuple[Recipe, NeuralProcess] | None = None,
) -> Manifest:
    """Measure, export, check and publish a fitted process as the next version of the recipe's model.

    Args:
        recipe: of the process.
        network: the fitted process.
        pushes: of all objects of the recipe's split.
        registry: receives the version.
        measured: see ``publish.publish``.

    Raises:
        PublishError: the graph disagrees with torch, or the disk refused. No version became visible.
        DataError: the data lack objects of the split, or no object was held out.
    """
    measured_recipe, measured_network = measured or (recipe, network)
    split, set_up = recipe.split(), measured_split(recipe, measured_recipe)
    if set_up.test_surface is not None:
        raise DataError(f"{recipe.name} on {set_up.name} is not published: it was measured on another surface")
    train, held_out = pushes.select(split.train), pushes.select(set_up.test)
    samples = Samples.of(held_out, _KIND)
    found = evaluate_supports(measured_network, samples)
    figures = {figures_name(set_up, count): each for count, each in found.predictions.items()}
    factors = dict(zip(figures, found.factors.values(), strict=True))
    metrics = finite_metrics(figures)
    present = train.valid > 0
    domain = SupportDomain().fit(*(torch.from_numpy(part[present]) for part in (train.pushers, train.outcomes)))
    served = ServedProcess(network, domain, torch.from_numpy(found.scales())).eval()
    model = export_module(served, _KIND, OUTPUTS_WITH_UNFAMILIARITY)
    parity = check_served_parity(served, model, _KIND, OUTPUTS_WITH_UNFAMILIARITY)
    batch = plausible_batch(_KIND, pushes=len(_CHECKED), objects=1, seed=4)
    batch = replace(batch, contexts=_checked_supports(samples), context_index=np.arange(len(_CHECKED)))
    ranges = {name: (low, high) for name, (low, high) in domain.ranges().items()}
    validity = Validity(
        {**ranges, "length_m": (PUSH_LENGTH_M, PUSH_LENGTH_M)}, _NOTE.format(1000 * ranges["start_distance_m"][1])
    )
    draft = draft_of(
        recipe,
        OUTPUTS_WITH_UNFAMILIARITY,
        data=data_record(pushes, split, train, held_out),
        metrics=metrics,
        calibration={name: calibration_of(each, factors[name]) for name, each in figures.items()},
        self_check=self_check_of(model, _KIND, OUTPUTS_WITH_UNFAMILIARITY, batch),
        validity=validity,
        rivals=_rivals(registry, recipe.name, set_up, samples),
    )
    return registry.publish(draft, model, render_support_card(draft, found, parity))


def figures_name(set_up: Split, count: int) -> str:
    """Return the name of the figures of a set-up with supports of this many pushes: for the paper's 50 its own."""
    return set_up.name if count == SUPPORT_PUSHES else f"{set_up.name}-{count}-pushes"


def support_tensors(support: Points) -> tuple[FloatArray, ...]:
    """Return normalised supports of some objects as the tensors of a graph, (objects, ...) each."""
    known = published_normalisation()
    pushers, outcomes = known.in_si(support.inputs.double().numpy(), support.targets.double().numpy())
    contexts = [
        SupportContext.of(pushers[row][valid], outcomes[row][valid]).tensors()
        for row, valid in enumerate(support.valid.numpy() > 0)
    ]
    return tuple(map(np.stack, zip(*contexts, strict=True)))


def predicted_supports(predictor: Predictor, samples: Samples, count: int, seed: int) -> Predictions:
    """Return the predictions of a published version, normalised, as ``evaluation.predictions`` makes them."""
    known = published_normalisation()
    support, targets = split_pushes(samples, seed, count)
    present = targets.valid > 0
    inputs, outcome = (part[present].numpy() for part in (targets.inputs, targets.targets))
    objects = torch.nonzero(present)[:, 0].numpy()
    pushers = (inputs * known.input_std + known.input_mean).astype(np.float32)
    return normalised(predictor.predict(pushers, support_tensors(support), objects), outcome, inputs, objects)


def _checked_supports(samples: Samples) -> tuple[FloatArray, ...]:
    """Return supports of the first objects: a network learns the symmetry of real ones, and gates turn theirs."""
    support, _ = split_pushes(samples.select(torch.arange(len(_CHECKED))), seed=0)
    tensors = support_tensors(support)
    seen = np.arange(SUPPORT_PUSHES) < np.array(_CHECKED)[:, None]
    return tuple(tensor * seen.reshape(*seen.shape, *[1] * (tensor.ndim - 2)).astype(np.float32) for tensor in tensors)


def _rivals(registry: Registry, name: str, set_up: Split, samples: Samples) -> dict[str, Rival] | None:
    """Measure the versions that aliases name on these held-out samples."""
    found = {}
    for version, predictor in named_predictors(registry, name):
        measured = {
            figures_name(set_up, count): joined(
                [predicted_supports(predictor, samples, count, seed) for seed in range(DRAWS)]
            )
            for count in COUNTS
        }
        found[str(version)] = Rival(
            {each: metrics_of(figures) for each, figures in measured.items()},
            {each: calibration_of(figures) for each, figures in measured.items()},
        )
    return found or None
