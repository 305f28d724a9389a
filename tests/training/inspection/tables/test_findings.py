"""Findings about a table: each check with its severity, and none for plausible pushes of enough objects."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.pushing.outlines import Outline
from tests.training.tables.tables import WEDGE, pushed_table
from training.inspection.findings import DatasetFinding, Severity
from training.inspection.tables.findings import outline_key, rows_of
from training.inspection.tables.inspection import inspect_table
from training.tables.push_table import PushTable

ERROR, WARNING = Severity.ERROR, Severity.WARNING
NAMES = tuple(f"wedge{number}" for number in range(10))
Change = Callable[[PushTable], None]


@pytest.fixture(scope="module")
def plausible() -> PushTable:
    """Pushes of ten objects of different sizes."""
    sizes = np.linspace(0.8, 1.5, len(NAMES))
    outlines = {name: Outline.of(np.array(WEDGE) * size) for name, size in zip(NAMES, sizes.tolist(), strict=True)}
    return pushed_table(outlines, 20)


@pytest.fixture
def table(plausible: PushTable) -> PushTable:
    """A copy of the pushes, to be changed by a test."""
    return replace(plausible, pushers=plausible.pushers.copy(), outcomes=plausible.outcomes.copy())


def findings(table: PushTable) -> list[DatasetFinding]:
    """Return the findings about a table."""
    return list(inspect_table(Path("here"), table, quiet=True).findings)


def codes_of(table: PushTable) -> list[tuple[Severity, str]]:
    """Return the severities and codes of the findings."""
    return [(finding.severity, finding.code) for finding in findings(table)]


def test_plausible_pushes_have_no_finding(table: PushTable) -> None:
    """Return no finding for plausible pushes, so that every finding below is caused by its damage."""
    assert findings(table) == []


def backwards(pushers: np.ndarray, outcomes: np.ndarray, row: int) -> None:
    """Move an object against the push by 20 mm."""
    outcomes[row] = -0.02 * np.cos(pushers[row, 2]), -0.02 * np.sin(pushers[row, 2]), 0.0


def onwards(pushers: np.ndarray, outcomes: np.ndarray, row: int) -> None:
    """Move an object by 80 mm along a push of 50 mm."""
    outcomes[row] = 0.08 * np.cos(pushers[row, 2]), 0.08 * np.sin(pushers[row, 2]), 0.0


def inside(pushers: np.ndarray, outcomes: np.ndarray, row: int) -> None:
    """Start a push in the middle of the object."""
    pushers[row, :2] = 0.01, 0.01


def away(pushers: np.ndarray, outcomes: np.ndarray, row: int) -> None:
    """Start a push half a metre away from an object that moves."""
    pushers[row, 0] += 0.5


def left(pushers: np.ndarray, outcomes: np.ndarray, row: int) -> None:
    """Leave an object where it was, although the tip goes through it."""
    outcomes[row] = 0.0


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (backwards, "pulls"),
        (onwards, "too-far"),
        (inside, "starts-inside"),
        (away, "moved-untouched"),
        (left, "ends-inside"),
    ],
)
@pytest.mark.parametrize(("rows", "severity"), [(1, WARNING), (4, ERROR)])
def test_impossible_pushes_are_found(
    table: PushTable, damage: Callable[..., None], code: str, rows: int, severity: Severity
) -> None:
    """Find an impossible push among 200 as a warning with its row, and one in fifty as an error."""
    for row in range(30, 30 + rows):
        damage(table.pushers, table.outcomes, row)

    found = {finding.code: finding for finding in findings(table)}
    assert found[code].severity is severity
    assert f"{rows} of 200 pushes" in found[code].message
    assert "31" in found[code].message


def test_angles_that_are_not_wrapped_are_found(table: PushTable) -> None:
    """Find angles from 0 to 2 pi, which mean the same but are outside the range of a model."""
    table.pushers[:, 2] %= 2.0 * np.pi
    assert (ERROR, "angles-unwrapped") in codes_of(table)


def test_an_object_that_never_moved_is_an_error(table: PushTable) -> None:
    """Find the object without motion by its name, although the others moved."""
    table.outcomes[:20] = 0.0
    found = {finding.code: finding for finding in findings(table)}
    assert found["objects-still"].severity is ERROR
    assert NAMES[0] in found["objects-still"].message
    assert NAMES[1] not in found["objects-still"].message


def test_equal_rows_are_counted(table: PushTable) -> None:
    """Find a push that occurs twice, but no push from the same start with another outcome."""
    for array in (table.pushers, table.outcomes):
        array[5] = array[0]
    table.pushers[7] = table.pushers[8]

    found = {finding.code: finding for finding in findings(table)}
    assert "1 push repeats an earlier one to the last digit (row 6)" in found["pushes-twice"].message


def test_pushes_from_the_same_start_scatter_as_recorded_ones_do(table: PushTable) -> None:
    """Find outcomes from the same start that are far apart, and those that are equal to the last digit."""
    starts, outcomes = table.pushers[:20:2].copy(), table.outcomes[:20:2].copy()
    table.pushers[1:20:2], table.outcomes[1:20:2] = starts, outcomes + np.array([1e-9, 0.0, 0.0])
    assert codes_of(table) == [(WARNING, "scatter")]

    far = pushed_table({name: Outline.of(WEDGE) for name in NAMES[:1]}, 40)
    far.pushers[20:], far.outcomes[20:] = far.pushers[:20], far.outcomes[:20] + np.array([0.0, 0.0, 0.3])
    assert (ERROR, "scatter") in codes_of(far)


def test_objects_with_the_same_outline_or_pushes_are_found(table: PushTable) -> None:
    """Find one outline under two names, even moved and turned, and one set of pushes under two names."""
    turned = table.objects[0].outline.corners @ [[0.0, 1.0], [-1.0, 0.0]]
    second = pushed_table({"first": table.objects[0].outline, "again": Outline.of(turned + 0.01)}, 20)
    assert (WARNING, "same-outline") in codes_of(second)

    same = table.select(np.arange(40))
    same.pushers[20:], same.outcomes[20:] = same.pushers[:20], same.outcomes[:20]
    assert (ERROR, "same-pushes") in codes_of(
        replace(same, objects=(same.objects[0], replace(same.objects[0], name="b")))
    )


def test_the_outline_of_a_mirrored_object_is_another_one() -> None:
    """Return equal keys from any first corner and in either orientation, and another key for the mirror image."""
    wedge = np.array(WEDGE)
    assert outline_key(Outline.of(np.roll(wedge, 2, axis=0)[::-1])) == outline_key(Outline.of(wedge))
    assert outline_key(Outline.of(wedge * (1, -1))) != outline_key(Outline.of(wedge))


def test_too_few_pushes_say_what_they_are_worth(table: PushTable) -> None:
    """Say of 5 pushes of one object that they score a model to about 45 % and train none."""
    found = {finding.code: finding.message for finding in findings(table.select(np.arange(5)))}
    assert (
        "5 pushes of 1 object: enough to score a model on them, with a mean error known to about 45 %"
        in found["few-objects"]
    )
    assert "wedge0 (5)" in found["few-pushes"]


def test_objects_without_pushes_are_found(table: PushTable) -> None:
    """Find an outline that no push names."""
    assert codes_of(replace(table, objects=(*table.objects, replace(table.objects[0], name="spare")))) == [
        (WARNING, "objects-unused")
    ]


def test_rows_are_shown_from_one() -> None:
    """Show the first five rows of a mask, counted from 1."""
    assert rows_of(np.array([False, True])) == "row 2"
    assert rows_of(np.ones(7, dtype=np.bool_)) == "rows 1, 2, 3, 4, 5 ..."
