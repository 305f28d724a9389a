"""Text and JSON of an inspection."""

import json
from pathlib import Path

import pytest

from tests.training.synthetic_omnipush import write_surface, write_views
from training.inspection.findings import DatasetFinding, Severity
from training.inspection.inspection import Inspection, inspect
from training.inspection.text import SHOWN, inspection_document, inspection_lines, next_step, statistics_lines
from training.omnipush.published import different_surfaces, omnipush_descriptors


@pytest.fixture
def found(tmp_path: Path) -> Inspection:
    """Inspection of a plywood surface of which one object has no view."""
    write_surface(tmp_path / "plywood", different_surfaces().test)
    write_views(tmp_path / "top-down_view", different_surfaces().test[1:])
    return inspect(tmp_path, quiet=True)


def test_the_text_has_every_count_and_the_table(found: Inspection) -> None:
    """The text has the counts of a surface, its statistics, the warnings and the next step."""
    lines = list(inspection_lines(found))

    assert lines[0] == f"{found.folder / 'plywood'}: plywood, synthetic pushes of a test"
    assert lines[1] == "  objects  10: 10 of 10 test, 0 under a turned name, 0 extra"
    assert lines[2] == "  pushes   2500, 250 to 250 an object, median 250"
    assert lines[3] == "  files    10 raw pairs, 0 normalised; 20 float64"
    assert lines[4] == "  contact  0.00 % of the pushes did not move the object"
    assert lines[5] == "  views    9 of 10 objects have a top-down view"
    assert lines[6:13] == ["  " + line for line in statistics_lines(found.surfaces[0].figures)]
    assert lines[14] == "warnings:"
    assert lines[15].startswith(f"  views-missing: {found.folder / 'plywood'}: no top-down view of 1 object")
    assert lines[16:] == [next_step(found)]


def test_the_table_s_columns_stand_under_their_names(found: Inspection) -> None:
    """The seven lines of the table have the same width."""
    lines = list(statistics_lines(found.surfaces[0].figures))

    assert len(lines) == 7
    assert {len(line) for line in lines} == {len(lines[0])}


def test_the_document_has_the_same_as_json(found: Inspection) -> None:
    """The document holds the same report in plain values that survive a round trip through JSON."""
    document = json.loads(json.dumps(inspection_document(found)))
    (surface,) = document["surfaces"]

    assert document["folder"] == str(found.folder)
    assert document["fit_to_train_on"] is True
    assert document["next"] == next_step(found)
    assert [(each["severity"], each["code"]) for each in document["findings"]] == [("warning", "views-missing")]
    assert (surface["surface"], surface["objects"], surface["pushes"], surface["views"]) == ("plywood", 10, 2500, 9)
    assert surface["rows_per_object"] == {"min": 250, "median": 250.0, "max": 250}
    assert surface["published_objects"] == {"test": {"present": list(different_surfaces().test), "missing": []}}
    assert surface["statistics"]["object yaw_rad"]["published_std"] == 0.21515865623950958
    assert surface["missed_share"] == 0.0


def finding(severity: Severity, number: int = 0) -> DatasetFinding:
    """Return a finding that names its file."""
    return DatasetFinding(severity, "refused", "abs", f"abs/{number}.npy is broken; fetch it again")


def test_errors_come_first(tmp_path: Path) -> None:
    """Errors are listed before warnings, and the last line counts them and gives the next step."""
    found = Inspection(tmp_path, (), (finding(Severity.WARNING), finding(Severity.ERROR)))
    lines = list(inspection_lines(found))

    assert lines == [
        "errors, on which training would be wrong:",
        "  refused: abs/0.npy is broken; fetch it again",
        "warnings:",
        "  refused: abs/0.npy is broken; fetch it again",
        f"1 error, 1 warning; next: fix the errors, then cazsl-train data check {tmp_path}",
    ]


def test_long_lists_of_findings_are_cut(tmp_path: Path) -> None:
    """The text lists the first findings of a severity, and the JSON document lists all."""
    found = Inspection(tmp_path, (), tuple(finding(Severity.ERROR, number) for number in range(SHOWN + 5)))
    lines = list(inspection_lines(found))

    assert len(lines) == SHOWN + 3
    assert lines[-2] == "  ... and 5 more; --json lists all"
    assert len(inspection_document(found)["findings"]) == SHOWN + 5


def test_the_next_step_after_a_good_check_is_to_fit(tmp_path: Path, found: Inspection) -> None:
    """The next step is a fit on the ABS surface, and plywood is proposed for testing."""
    write_surface(tmp_path / "data" / "abs", omnipush_descriptors(), rows=2)

    assert next_step(inspect(tmp_path / "data", quiet=True)).endswith(
        f"next: cazsl-train fit push-indicator --data {tmp_path / 'data' / 'abs'}"
    )
    assert next_step(found) == (
        "0 errors, 1 warning; next: train on ABS and use this surface to test: cazsl-train fit push-indicator"
    )
