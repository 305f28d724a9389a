"""The card of a version of shapes: data, figures by part and band, other scores, and the domain."""

from dataclasses import replace
from pathlib import Path

import pytest

from service.model.manifest import Calibration, Validity
from service.model.tensors import ContextKind
from tests.fakes import draft_manifest
from tests.training.publishing.published_graphs import load_push_network
from training.fitting.recipe import Recipe
from training.fitting.shape_evaluation import SEEN, UNSEEN, evaluate_shapes
from training.fitting.shape_samples import read_shapes
from training.publishing.shape_card import render_shape_card

SCORES = "## Recorded pushes\n\n12 pushes of a test: 1.0 mm."


@pytest.fixture(scope="module")
def card(shape_recipe: Recipe, shape_run: Path, shapes_folder: Path) -> str:
    """Render the card of a run."""
    table, split = read_shapes(shapes_folder, shape_recipe.set_up)
    figures = evaluate_shapes(load_push_network(shape_run), split, shape_recipe.seed)
    manifest = draft_manifest("push-shape", ContextKind.SHAPE)
    draft = replace(
        manifest,
        data=replace(manifest.data, source=table.source, sha256=table.digest),
        calibration={SEEN: Calibration("of a test", 0.5, 0.9, 0.95, [0.1] * 3, 1.234)},
        validity=Validity({"length_m": (0.005, 0.12)}, "pushes of a test"),
    )
    return render_shape_card(draft, figures, 1e-6, SCORES)


def test_the_card_names_its_data_and_figures(card: str) -> None:
    """Source, both held-out parts, the factor, and that no recorded push was learnt from."""
    assert "Trained on **simulated pushes of drawn shapes (quasi-static, seed 0)**" in card
    assert "hold no recorded push" in " ".join(card.split())
    assert f"| {SEEN} | " in card
    assert f"| {UNSEEN} | " in card
    assert "wrench" in card
    assert "times 1.234" in card


def test_the_card_shows_coverage_by_band(card: str) -> None:
    """Length, size, start and aim each have bands with a count of pushes and a share."""
    for band in ("length 20 to 50 mm", "size 20 to 40 mm", "start from the centroid", "aim from the centroid"):
        assert f"| {band}" in card


def test_the_card_has_other_scores_and_the_domain(card: str) -> None:
    """The text on recorded pushes is there as given, before the ranges that the version vouches for."""
    assert SCORES in card
    assert card.index(SCORES) < card.index("## Domain") < card.index("| length_m | 0.005 | 0.12 |")
