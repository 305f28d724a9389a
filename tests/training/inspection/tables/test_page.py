"""Report page of a table: its numbers and images, equal for equal pushes, and safe for names of other people."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from service.pushing.outlines import Outline
from tests.training.tables.tables import WEDGE, pushed_table
from training.inspection.statistics import motion_quantiles
from training.inspection.tables.geometry import push_geometry
from training.inspection.tables.page import report, write_report
from training.tables.push_table import PushTable


@pytest.fixture(scope="module")
def table() -> PushTable:
    """Pushes of one object."""
    return pushed_table({"wedge": Outline.of(WEDGE)}, 30)


def test_the_same_pushes_give_the_same_files(table: PushTable, tmp_path: Path) -> None:
    """Write the page twice, beside another table: all files are equal, byte by byte."""
    other = ("other", pushed_table({"wedge": Outline.of(WEDGE)}, 10, seed=1))
    first = write_report(table, tmp_path / "a", other, quiet=True)
    again = write_report(table, tmp_path / "b", other, quiet=True)

    assert [path.name for path in first] == ["report.md", "histograms.png", "pushes.png"]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in again]
    for path in first[1:]:
        with Image.open(path) as image:
            assert min(image.size) > 400
            assert len(set(image.convert("L").get_flattened_data())) > 50  # it is not blank


def test_the_page_has_the_quantiles_of_both_tables(table: PushTable) -> None:
    """Print the quantiles of the motion of each table in its own rows."""
    other = table.select(np.arange(10))
    page = report(table, push_geometry(table), ("other", other))
    for name, each in (("", table), (", other", other)):
        values = " | ".join(f"{value:.1f}" for value in motion_quantiles(each.outcomes).distance_mm)
        assert f"| distance (mm){name} | {values} |" in page


def test_names_of_other_people_are_only_text(table: PushTable) -> None:
    """Escape names that would be links, markup, cells or controls on the page, and shorten long ones."""
    hostile = replace(table.objects[0], name="[x](http://a) | <b>\x1b[31m" + "y" * 200)
    page = report(replace(table, objects=(hostile,), source="a\n# title"), push_geometry(table))
    assert r"\[x\]\(http://a\) \| \<b\> \[31m" in page
    assert "\x1b" not in page
    assert page.splitlines()[0] == r"# a \# title"
    assert "y" * 100 not in page


def test_names_in_any_script_are_drawn(table: PushTable, tmp_path: Path) -> None:
    """Draw a page of an object whose name the font lacks, or which looks like a formula, without a warning."""
    named = replace(table, objects=(replace(table.objects[0], name="\u7bb1 $\\frac$"),), source="\u7bb1")
    assert len(write_report(named, tmp_path, quiet=True)) == 3
