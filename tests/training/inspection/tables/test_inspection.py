"""Inspection of a table: wrong units and frames are told once, not by their consequences."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.pushing.outlines import Outline
from tests.training.tables.tables import WEDGE, pushed_table
from training.inspection.tables.inspection import inspect_table
from training.tables.push_table import PushTable


@pytest.fixture(scope="module")
def table() -> PushTable:
    """Pushes of one object."""
    return pushed_table({"wedge": Outline.of(WEDGE)}, 80)


def codes(table: PushTable) -> list[str]:
    """Return the codes of the findings."""
    return [finding.code for finding in inspect_table(Path("here"), table, quiet=True).findings]


def test_one_object_is_fit_to_score_on(table: PushTable) -> None:
    """Warn that one object is few, without an error."""
    found = inspect_table(Path("here"), table, quiet=True)
    assert found.fit_to_train_on
    assert codes(table) == ["few-objects"]
    assert found.rows == (80, 80.0, 80)


def test_wrong_units_are_told_once(table: PushTable) -> None:
    """Find millimetres, and none of the pushes that look impossible because of them."""
    assert codes(replace(table, pushers=table.pushers * (1e3, 1e3, 1, 1e3))) == ["units", "units", "few-objects"]


def test_a_wrong_frame_is_told_once(table: PushTable) -> None:
    """Find shuffled rows as one fault of the frame."""
    assert codes(replace(table, outcomes=np.roll(table.outcomes, 7, axis=0))) == ["frame", "few-objects"]
