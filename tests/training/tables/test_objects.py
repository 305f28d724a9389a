"""Outlines of a table: order of the corners, properties, and polygons that are none."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from service.errors import DataError
from tests.training.tables.tables import BOX, corner_rows, write_folder
from training.tables.push_table import TableObject
from training.tables.reading import read_table

ROWS = corner_rows()


def read(folder: Path, rows: Sequence[dict[str, Any]]) -> tuple[TableObject, ...]:
    """Return the objects of a table with these rows of corners."""
    return read_table(write_folder(folder, corners=rows)).objects


def test_properties_of_an_object_stand_in_any_of_its_rows(tmp_path: Path) -> None:
    """Read mass, friction and centre of mass from the first row, from all rows, and None from empty cells."""
    rows: list[dict[str, object]] = [
        {
            **row,
            "centre_of_mass_x_m": 0.01,
            "centre_of_mass_y_m": 0.0,
            "mass_kg": 0.3 if number == 0 else "",
            "friction": "",
        }
        for number, row in enumerate(ROWS)
    ]
    (box,) = read(tmp_path, rows)
    assert (box.centre_of_mass_m, box.mass_kg, box.friction) == ((0.01, 0.0), 0.3, None)


def test_corners_count_from_one_or_zero_either_way_round(tmp_path: Path) -> None:
    """Read corners that are numbered from 1 and go clockwise. They are kept counter-clockwise."""
    rows = [{**row, "corner": number + 1} for number, row in enumerate(corner_rows(corners=BOX[::-1]))]
    (box,) = read(tmp_path, rows)
    assert box.outline.area_m2 == pytest.approx(0.006)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        pytest.param(ROWS[:2], "object 'box', outline: received 2 corners", id="two corners"),
        pytest.param(
            corner_rows(corners=(BOX[0], BOX[2], BOX[1], BOX[3])), "edges 0 and 2 that cross or touch", id="crossing"
        ),
        pytest.param(
            corner_rows(corners=(*BOX, BOX[0])), "outline.4: received the same point as corner 0", id="closed"
        ),
        pytest.param(
            corner_rows(corners=[(1e3 * x, 1e3 * y) for x, y in BOX]), "in millimetres, divide them by 1000", id="mm"
        ),
        pytest.param(
            corner_rows(corners=[(1e2 * x, 1e2 * y) for x, y in BOX]), "in centimetres, divide them by 100", id="cm"
        ),
        pytest.param([ROWS[0], *ROWS[2:]], "row 2 (line 3), column corner: received 2 in object 'box'", id="a gap"),
        pytest.param([*ROWS[1::-1], *ROWS[2:]], "row 1 (line 2), column corner: received 1", id="out of order"),
        pytest.param([*ROWS, *ROWS], "row 5 (line 6), column corner: received 0 in object 'box' again", id="twice"),
        pytest.param(
            [*ROWS, *corner_rows("b"), *ROWS], "row 9 (line 10), column object: received object 'box' again", id="apart"
        ),
        pytest.param(
            [{**row, "mass_kg": -1} for row in ROWS], "column mass_kg: received -1; accepted is a posi", id="mass"
        ),
        pytest.param(
            [{**row, "mass_kg": number + 1} for number, row in enumerate(ROWS)], "received 2 after 1", id="two masses"
        ),
        pytest.param(
            [{**row, "centre_of_mass_x_m": 0} for row in ROWS], "has no column centre_of_mass_y_m", id="half a centre"
        ),
        pytest.param(
            [{**row, "centre_of_mass_x_m": 0, "centre_of_mass_y_m": ""} for row in ROWS],
            "column centre_of_mass_y_m: received an empty cell; accepted is both coordinates, or neither",
            id="an empty half",
        ),
        pytest.param([{**row, "x_m": "nan"} for row in ROWS], "row 1 (line 2), column x_m: received 'nan'", id="nan"),
    ],
)
def test_an_outline_that_is_none_is_named(tmp_path: Path, rows: Sequence[dict[str, Any]], words: str) -> None:
    """Name the object or the row, the fault, and the cure, in one line."""
    with pytest.raises(DataError) as caught:
        read(tmp_path, rows)
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"{tmp_path / 'objects.csv'}: ")
    assert words in line
