"""Publication of a neural process: the manifest, the served version, its card, and refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from service.errors import DataError
from service.model.manifest import Manifest
from service.model.predictor import OnnxPredictor
from service.model.self_check import stored_contexts
from service.model.tensors import ContextKind
from service.pushing.gates import PUSHING
from service.registry.loading import load_version
from service.registry.registry import Registry
from training.fitting.run_folder import load_run
from training.fitting.samples import Samples
from training.fitting.support_evaluation import COUNTS, evaluate_supports
from training.networks.neural_process import NeuralProcess, Points
from training.omnipush.published import different_objects, published_normalisation
from training.omnipush.pushes import Pushes
from training.publishing.parity_inputs import plausible_batch
from training.publishing.support_publish import publish_supports


def process_of(run: Path) -> NeuralProcess:
    """Load the process of a run."""
    network = load_run(run)[1]
    assert isinstance(network, NeuralProcess)
    return network


@pytest.fixture(scope="module")
def store(support_run: Path, pushes: Pushes, tmp_path_factory: pytest.TempPathFactory) -> Registry:
    """Publish the process twice, with the first version as the champion."""
    found = Registry(tmp_path_factory.mktemp("supports") / "models")
    recipe = load_run(support_run)[0]
    publish_supports(recipe, process_of(support_run), pushes, found)
    found.point_alias("push-anp", "champion", 1)
    publish_supports(recipe, process_of(support_run), pushes, found)
    return found


def manifest_of(store: Registry, version: int = 1) -> Manifest:
    """Return the manifest of a version."""
    return store.read("push-anp", version).manifest


def test_the_served_version_gives_the_numbers_of_torch(store: Registry, support_run: Path, pushes: Pushes) -> None:
    """Means and deviations of pushes of objects with supports of any count are the process's, times its factor."""
    model, network, known = (
        load_version(store, OnnxPredictor, "push-anp", 1),
        process_of(support_run),
        published_normalisation(),
    )
    batch = plausible_batch(ContextKind.SUPPORT, 9, 3, seed=5)
    found = model.predictor.predict(batch.pusher, batch.contexts, batch.context_index)
    pushers, outcomes, valid = batch.contexts
    inputs, targets = known.normalised(pushers.astype(np.float64), outcomes.astype(np.float64))
    support = Points(torch.from_numpy(inputs).float(), torch.from_numpy(targets).float(), torch.from_numpy(valid))
    asked = torch.from_numpy((batch.pusher - known.input_mean) / known.input_std).float()
    with torch.no_grad():
        mean, log_std = network(support, asked.expand(3, -1, -1))
    rows = np.arange(9)
    expected = mean.numpy()[batch.context_index, rows] * known.output_std + known.output_mean
    scales = evaluate_supports(
        network, Samples.of(pushes.select(different_objects().test), ContextKind.SUPPORT)
    ).scales()
    factor = scales[valid.sum(axis=1).astype(int)][batch.context_index, None]
    spread = np.exp(log_std.numpy()[batch.context_index, rows]) * known.output_std * factor

    np.testing.assert_allclose(found.mean, expected, atol=1e-5)
    np.testing.assert_allclose(found.std, spread, rtol=1e-4)
    assert found.unfamiliarity is not None
    assert found.unfamiliarity.shape == (9, 2)


def test_the_manifest_has_figures_by_the_number_of_pushes(store: Registry) -> None:
    """The paper's 50 pushes have the name of the set-up, and each other number its own, all with their factors."""
    found = manifest_of(store)
    names = ["different-objects", *(f"different-objects-{count}-pushes" for count in COUNTS[1:])]

    assert sorted(found.metrics) == sorted(found.calibration) == sorted(names)
    assert (found.method, found.context_kind, found.data.held_out_objects) == ("ANP", "support", 50)
    assert found.validity is not None
    assert "support_furthest_move_m" in found.validity.ranges
    assert "1 to 50 such pushes" in found.validity.note
    assert all(each.scale is not None for each in found.calibration.values())


def test_the_self_check_has_supports_of_several_counts(store: Registry) -> None:
    """Gates are tried on its supports, which are of real pushes, padded with zeros."""
    pushers, outcomes, valid = stored_contexts(manifest_of(store))
    assert len(valid) == 4
    assert (valid.sum(axis=1) >= 1.0).all()
    assert not pushers[valid == 0.0].any()
    assert not outcomes[valid == 0.0].any()
    verdicts = list(PUSHING.gates(load_version(store, OnnxPredictor, "push-anp", 1)))
    assert [verdict.gate for verdict in verdicts] == ["no-contact", "turned", "angle-at-pi"]


def test_the_champion_is_measured_on_the_same_supports(store: Registry) -> None:
    """The next version has the champion's figures by every number of pushes, and they are those of its own data."""
    first, second = manifest_of(store), manifest_of(store, 2)
    assert first.rivals is None
    assert second.rivals is not None
    rival = second.rivals["1"]
    assert sorted(rival.metrics) == sorted(first.metrics)
    for name, figures in first.metrics.items():
        assert rival.metrics[name].rmse == pytest.approx(figures.rmse, abs=1e-4)


def test_the_card_has_a_row_for_every_number_of_pushes(store: Registry) -> None:
    """The card says that the model is not zero-shot, and has error, coverage and factor by the number of pushes."""
    card = store.read("push-anp", 1).card
    assert "It is not zero-shot" in " ".join(card.split())
    for count in COUNTS:
        assert f"\n| {count} | " in card
    assert "| support_largest_turn_rad | " in card
    assert "| 50 pushes | pushes | RMSE |" in card


def test_a_process_of_all_objects_needs_a_run_that_held_some_out(
    support_run: Path, pushes: Pushes, tmp_path: Path
) -> None:
    """Its figures are those of the run that is named, under the name of its set-up."""
    recipe, network = load_run(support_run)[0], process_of(support_run)
    everything = replace(recipe, set_up="all-objects")
    with pytest.raises(DataError, match="no held-out objects"):
        publish_supports(everything, network, pushes, Registry(tmp_path / "models"))
    found = publish_supports(everything, network, pushes, Registry(tmp_path / "models"), (recipe, network))
    assert (found.data.split, "different-objects" in found.metrics) == ("all-objects", True)
    surface = replace(recipe, set_up="different-surfaces")
    with pytest.raises(DataError, match="another surface"):
        publish_supports(surface, network, pushes, Registry(tmp_path / "models"))
