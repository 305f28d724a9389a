"""Evaluation of shapes: in SI units as served, calibrated on objects that a network was not trained on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mapie.regression import SplitConformalRegressor
from scipy.stats import chi2
from sklearn.dummy import DummyRegressor

from training.fitting.evaluation import Predictions
from training.fitting.recipe import ALL_FAMILIES, DIFFERENT_FAMILIES
from training.fitting.run_folder import load_run
from training.fitting.shape_evaluation import (
    LEVEL,
    REGION,
    SEEN,
    UNSEEN,
    conformal_factor,
    evaluate_shapes,
    normalised,
    predict_shapes,
    region_factor,
    touching,
)
from training.fitting.shape_samples import read_shapes, shape_batch
from training.networks.push_network import PushNetwork
from training.omnipush.published import published_normalisation


@pytest.fixture(scope="module")
def network(shape_run: Path) -> PushNetwork:
    """Load the fitted network of shapes."""
    found = load_run(shape_run)[1]
    assert isinstance(found, PushNetwork)
    return found


def gaussians(count: int, spread: float) -> Predictions:
    """Return predictions of std 1 whose errors are ``spread`` times as wide."""
    rng = np.random.default_rng(1)
    outcome = spread * rng.standard_normal((count, 3)).astype(np.float32)
    zeros = np.zeros((count, 3), dtype=np.float32)
    pusher = np.zeros((count, 4), dtype=np.float32)
    return Predictions(zeros, zeros, outcome, pusher, np.arange(count) // 10, (1.0, 1.0, 1.0))


def test_the_region_is_that_of_chi_squared() -> None:
    """The constant is the quantile of a known library."""
    assert chi2.ppf(LEVEL, 3) == pytest.approx(REGION, abs=1e-3)


@pytest.mark.parametrize("spread", [0.5, 1.0, 2.0])
def test_the_factor_finds_how_much_too_sure_deviations_are(spread: float) -> None:
    """Errors twice as wide as the std have a factor of 2, and scaled regions hold their share."""
    found = gaussians(20_000, spread)
    factor = region_factor(found)
    assert factor == pytest.approx(spread, rel=0.03)
    assert found.scaled(factor).regions()[1] == pytest.approx(LEVEL, abs=1e-3)


def test_the_factor_is_that_of_a_library_of_conformal_prediction() -> None:
    """The half width of an interval for distances from 0, as MAPIE calibrates it, is the limit of ours."""
    found = gaussians(997, 1.3)
    distances = np.sqrt(np.sum(found.z() ** 2, axis=1))
    rows = np.zeros((len(distances), 1))
    zero = DummyRegressor(strategy="constant", constant=0.0).fit(rows, distances)
    library = SplitConformalRegressor(zero, confidence_level=LEVEL, prefit=True).conformalize(rows, distances)
    high = library.predict_interval(rows[:1])[1][0, 1, 0]
    assert region_factor(found) * np.sqrt(REGION) == pytest.approx(high, rel=1e-6)


def test_the_factor_of_few_outcomes_is_that_of_the_largest() -> None:
    """With 5 outcomes no region holds 90 % for sure, so all of them are held."""
    found = gaussians(5, 1.0)
    assert found.scaled(region_factor(found) * 1.0001).regions()[1] == 1.0


def test_the_factor_grows_for_small_objects_that_scatter_more() -> None:
    """Regions hold their share of small objects too, and large ones keep the factor of all."""
    found, size_m = gaussians(30_000, 1.0), np.where(np.arange(30_000) % 3 == 0, 0.005, 0.05)
    wider = replace(found, outcome=found.outcome * np.where(size_m < 0.01, 2.0, 1.0)[:, None].astype(np.float32))
    factor = conformal_factor(wider, size_m)
    held = np.sum(wider.scaled(factor.of(size_m)).z() ** 2, axis=1) <= REGION
    assert held[size_m < 0.01].mean() == pytest.approx(LEVEL, abs=1e-3)
    assert factor.of(np.array([0.05, 0.02])).tolist() == [factor.scale, factor.scale]
    assert conformal_factor(found, size_m).small == pytest.approx(0.0, abs=0.02)
    assert conformal_factor(found, np.full(30_000, 0.05)).small == 0.0


def test_outcomes_are_compared_across_the_cut_of_angles(shapes_folder: Path) -> None:
    """An outcome just below pi is near a mean just above -pi."""
    table, _ = read_shapes(shapes_folder, ALL_FAMILIES)
    batch = shape_batch(table, np.zeros((len(table.objects), 3), dtype=np.bool_))
    mean, std = (np.full((table.count, 3), value, dtype=np.float32) for value in (0.0, 1.0))
    mean[:, 2] = -np.pi + 0.01
    batch.outcomes[:, 2] = np.pi - 0.01
    found = normalised(mean, std, batch)
    unit = published_normalisation().output_std[2]
    assert np.abs(found.outcome - found.mean)[:, 2] * unit == pytest.approx(0.02, abs=1e-3)


def test_predictions_are_of_the_pushes_that_touch(network: PushNetwork, shapes_folder: Path) -> None:
    """Pushes that miss are exactly at rest, so they are not judged."""
    _, split = read_shapes(shapes_folder, DIFFERENT_FAMILIES)
    batch = shape_batch(split.held_out, np.zeros((len(split.held_out.objects), 3), dtype=np.bool_))
    found = predict_shapes(network, batch)
    judged = touching(found)
    assert len(found.mean) == split.held_out.count
    assert 0 < len(judged.mean) < len(found.mean)
    assert (np.abs(judged.mean).max(axis=1) > 0.0).all()


def test_figures_are_of_held_out_objects_and_families(network: PushNetwork, shapes_folder: Path) -> None:
    """Each part has figures, and the factor is used on both."""
    _, split = read_shapes(shapes_folder, DIFFERENT_FAMILIES)
    found = evaluate_shapes(network, split, 0)
    assert list(found.predictions) == [SEEN, UNSEEN]
    assert found.factor.scale > 0.0
    assert found.factor.small >= 0.0
    assert all(np.isfinite(part.measures().nll) for part in found.predictions.values())
    again = evaluate_shapes(network, split, 0)
    assert again.factor == found.factor
    assert (again.predictions[UNSEEN].mean == found.predictions[UNSEEN].mean).all()


def test_a_set_up_of_all_families_has_no_unseen_part(network: PushNetwork, shapes_folder: Path) -> None:
    """Only held-out objects are left to judge."""
    _, split = read_shapes(shapes_folder, ALL_FAMILIES)
    assert list(evaluate_shapes(network, split, 0).predictions) == [SEEN]
