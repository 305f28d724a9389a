"""Text and JSON of an inspection of a table."""

import json
from pathlib import Path

import pytest

from service.pushing.outlines import Outline
from tests.training.tables.tables import WEDGE, pushed_table
from training.inspection.statistics import motion_quantiles
from training.inspection.tables.inspection import TableInspection, inspect_table
from training.inspection.tables.text import table_document, table_lines


@pytest.fixture(scope="module")
def inspection() -> TableInspection:
    """An inspection of 40 pushes of one object beside those of another seed."""
    wedge = {"wedge": Outline.of(WEDGE)}
    other = pushed_table(wedge, seed=1)
    return inspect_table(Path("here"), pushed_table(wedge), ("other", motion_quantiles(other.outcomes)), quiet=True)


def test_the_text_has_figures_findings_and_the_next_step(inspection: TableInspection) -> None:
    """Print the quantiles beside those of the other table, the warning, and the command to go on with."""
    lines = list(table_lines(inspection))

    assert lines[0] == "here: a test"
    assert "  pushes   40, 40 to 40 an object, median 40" in lines
    assert any(line.startswith("   other") and line.endswith("%") for line in lines)
    assert any(line.startswith("  few-objects: here: 40 pushes of 1 object") for line in lines)
    assert lines[-1].endswith("next: cazsl-train data report here")


def test_the_document_is_json_with_the_same_figures(inspection: TableInspection) -> None:
    """Write the quantiles in the document in full, and no number that JSON lacks."""
    document = json.loads(json.dumps(table_document(inspection), allow_nan=False))

    assert document["motion"]["distance_mm"] == list(inspection.motion.distance_mm)
    assert document["against"]["name"] == "other"
    assert [finding["code"] for finding in document["findings"]][-1] == "few-objects"
