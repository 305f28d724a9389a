"""Calibration on held-out objects and coverage by band."""

import math

import numpy as np
import pytest
import torch

from service.model.tensors import ContextKind
from training.fitting.bands import AIMS_MM, CAMERA, STARTS_MM, bands, calibrate, calibrated, conformal_factor
from training.fitting.evaluation import Predictions, joined
from training.fitting.samples import Samples
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.omnipush.published import published_normalisation


def gaussian(objects: int = 40, pushes: int = 100, wrong: float = 1.0, seed: int = 0) -> Predictions:
    """Draw outcomes around means of 0 with a std of ``wrong``, of which the predicted std is 1."""
    rng, count = np.random.default_rng(seed), objects * pushes
    zeros = np.zeros((count, 3), dtype=np.float32)
    outcome = (wrong * rng.normal(size=(count, 3))).astype(np.float32)
    return Predictions(zeros, zeros, outcome, zeros, np.repeat(np.arange(objects), pushes), (1.0, 1.0, 1.0))


def with_pushers(found: Predictions, pushers: list[tuple[float, float, float]]) -> Predictions:
    """Return the predictions of these pushes in m, m, rad, repeated."""
    known = published_normalisation()
    rows = np.resize(np.array(pushers), (len(found.mean), 3))
    inputs = ((rows - known.input_mean) / known.input_std).astype(np.float32)
    return Predictions(found.mean, found.log_std, found.outcome, inputs, found.objects, found.target_std)


@pytest.mark.parametrize("wrong", [0.5, 1.0, 3.0])
def test_the_factor_undoes_a_wrong_std(wrong: float) -> None:
    """Deviations that are too small or too large by a factor get that factor, and 90 % intervals then hold 90 %."""
    found = gaussian(wrong=wrong)
    factor = conformal_factor(found)

    assert factor == pytest.approx(wrong, rel=0.03)
    assert found.scaled(factor).measures().coverage[0.9] == pytest.approx(0.9, abs=1e-3)


def test_each_half_of_the_objects_gets_the_factor_of_the_other() -> None:
    """Objects of even number are scaled with the factor of the odd ones, and those with that of the even ones."""
    found = gaussian()
    outcome = np.where(found.objects[:, None] % 2 == 0, found.outcome, 2.0 * found.outcome).astype(np.float32)
    uneven = Predictions(found.mean, found.log_std, outcome, found.inputs, found.objects, found.target_std)

    scaled = calibrate({"": uneven}).predictions[""]

    std = np.exp(scaled.log_std[:, 0])
    assert std[scaled.objects % 2 == 0] == pytest.approx(2.0, rel=0.05)
    assert std[scaled.objects % 2 == 1] == pytest.approx(1.0, rel=0.05)


def test_bands_split_pushes_by_start_and_by_aim() -> None:
    """Every push is in one ring of starts and one band of aims, and headings away from the centre count too."""
    found = with_pushers(gaussian(10, 3), [(-0.05, 0.0, 0.0), (0.08, 0.03, 0.0), (0.0, 0.11, 0.0)])

    names = {band.name(): band.pushes for band in bands(found)}

    assert names == {
        "start 0 to 60 mm": 10,
        "start 75 to 90 mm": 10,
        "start 105 mm and more": 10,
        "aim 0 to 12 mm": 10,
        "aim 24 to 36 mm": 10,
        "aim 72 mm and more": 10,
    }
    assert (STARTS_MM[-1], AIMS_MM[-1]) == (math.inf, math.inf)


def test_a_band_has_the_figures_of_its_own_pushes() -> None:
    """A ring in which deviations are too small shows it, though the other ring is calibrated."""
    near, far = gaussian(wrong=3.0), gaussian(wrong=1.0, seed=1)
    found = joined([with_pushers(near, [(0.05, 0.0, 0.0)]), with_pushers(far, [(0.08, 0.0, 0.0)])])

    shares = {band.name(): band.found.coverage[0.9] for band in bands(found)}

    assert shares["start 0 to 60 mm"] == pytest.approx(0.416, abs=0.02)
    assert shares["start 75 to 90 mm"] == pytest.approx(0.9, abs=0.01)


def test_camera_views_are_calibrated_together_with_the_drawings() -> None:
    """The factor is of all kinds of views, and each kind keeps figures of its own."""
    torch.manual_seed(3)
    network = PushNetwork(METHODS["FCN + CM"], PUSH_SHAPES[ContextKind.VISUAL])
    rng = torch.Generator().manual_seed(2)
    inputs, targets = (torch.randn(6, 5, 3, generator=rng) for _ in range(2))
    views = torch.rand(6, 8, 1, 32, 32, generator=rng)
    samples = Samples(inputs, targets, torch.ones(6, 5), views[:, 0], (1.0, 1.0, 1.0), views)

    found = calibrated(network, samples)

    assert {kind: len(each.mean) for kind, each in found.predictions.items()} == {"": 30, CAMERA: 120}
    assert list(calibrated(network, samples.seen(torch.zeros(6, dtype=torch.int64))).predictions) == ["", CAMERA]
    assert found.factor > 0.0


def test_regions_of_a_calibrated_gaussian_hold_their_share() -> None:
    """The joint regions of three independent outputs hold 50, 90 and 95 % of the outcomes."""
    assert gaussian(100, 200).regions() == pytest.approx([0.5, 0.9, 0.95], abs=0.01)
