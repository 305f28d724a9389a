"""The card of a version that knows objects by supports: purpose, figures by the number of pushes, domain and limits."""

from dataclasses import replace

import numpy as np

from service.model.manifest import Validity
from service.model.tensors import ContextKind
from tests.fakes import draft_manifest
from training.fitting.evaluation import Predictions
from training.fitting.support_evaluation import COUNTS, SupportFigures
from training.publishing.support_card import render_support_card


def test_the_card_says_what_a_support_is_worth() -> None:
    """Every number of pushes has a row, fewest first, with its factor. The ranges of the domain follow."""
    rng = np.random.default_rng(0)
    inputs, outcome = rng.normal(size=(2, 40, 3)).astype(np.float32)
    predictions = {
        count: Predictions(outcome + 1.0 / count, np.zeros_like(outcome), outcome, inputs, np.arange(40), (1.0,) * 3)
        for count in COUNTS
    }
    figures = SupportFigures({count: 1.0 + 1.0 / count for count in COUNTS}, predictions)
    draft = replace(
        draft_manifest("push-anp", ContextKind.SUPPORT),
        validity=Validity({"length_m": (0.05, 0.05)}, "pushes of a test"),
    )
    card = render_support_card(draft, figures, 1e-6)
    rows = [line for line in card.splitlines() if line.endswith(("2.000 |", "1.500 |", "1.020 |"))]

    assert [row.split(" | ")[0] for row in rows] == ["| 1", "| 2", "| 50"]
    assert rows[0].split(" | ")[1] == "1.0000"
    assert "vouches for pushes of a test." in card
    assert "| length_m | 0.05 | 0.05 |" in card
    assert "any object" not in card


def test_the_card_of_a_version_of_all_objects_names_the_run_that_was_measured() -> None:
    """Figures of another run say so."""
    rng = np.random.default_rng(0)
    inputs, outcome = rng.normal(size=(2, 40, 3)).astype(np.float32)
    each = Predictions(outcome, np.zeros_like(outcome), outcome, inputs, np.arange(40), (1.0,) * 3)
    draft = draft_manifest("push-anp", ContextKind.SUPPORT)
    figures = SupportFigures(dict.fromkeys(COUNTS, 1.0), dict.fromkeys(COUNTS, each))

    assert "trained on every object" not in render_support_card(draft, figures, 1e-6)
    draft = replace(draft, data=replace(draft.data, split="all-objects"))
    assert "trained on every object" in render_support_card(draft, figures, 1e-6)
