"""Figures of a table: which pushes the gallery shows, and figures of few and odd pushes."""

from dataclasses import replace

import numpy as np
import pytest

from service.pushing.outlines import Outline
from tests.training.tables.tables import BOX, WEDGE, pushed_table
from training.inspection.tables.figures import distributions, gallery, plain
from training.inspection.tables.geometry import push_geometry
from training.tables.push_table import PushTable


@pytest.fixture(scope="module")
def table() -> PushTable:
    """Pushes of two objects."""
    return pushed_table({"wedge": Outline.of(WEDGE), "box": Outline.of(BOX)}, 20)


def titles(table: PushTable) -> list[str]:
    """Return the titles of the frames of the gallery that hold a push."""
    return [place.get_title() for place in gallery(table).axes if place.get_title()]


def test_the_gallery_shows_each_push_once(table: PushTable) -> None:
    """Show 24 pushes of 40, half of each object, and with 3 pushes all of them once."""
    shown = titles(table)
    assert len(set(shown)) == len(shown) == 24
    assert sum(title.startswith("box") for title in shown) == 12
    assert len(titles(table.select(np.array([0, 1, 25])))) == 3


def test_the_gallery_draws_the_path_with_length_and_radius(table: PushTable) -> None:
    """Draw two tips of the radius, 50 mm apart, and both outlines."""
    frame = gallery(table.select(np.array([0]))).axes[0]
    start, end = frame.patches[2:]
    assert np.hypot(*np.subtract(start.center, end.center)) == pytest.approx(50.0)  # type: ignore[attr-defined]
    assert start.radius == end.radius == pytest.approx(4.75)  # type: ignore[attr-defined]


def test_one_push_and_objects_that_stay_can_be_drawn(table: PushTable) -> None:
    """Draw the distributions of a single push, and of pushes that moved nothing, beside others."""
    for each in (table.select(np.array([0])), replace(table, outcomes=np.zeros_like(table.outcomes))):
        measured = ("a", each, push_geometry(each))
        assert len(distributions(measured, measured).axes) == 8


def test_texts_of_figures_are_plain() -> None:
    """Return one short line without controls, and without a formula."""
    assert plain("a\nb\x1b$x$") == r"a b \$x\$"
    assert len(plain("x" * 1000)) == 63
