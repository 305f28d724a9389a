"""Reading of tables: numbers, names, aliases, other columns, and faults in one line each."""

from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from tests.training.tables.tables import PUSH, corner_rows, csv_text, write_folder
from training.tables.reading import read_table


def test_a_table_is_read_as_it_is_written(tmp_path: Path) -> None:
    """Read a table of one push: numbers in the order of the documentation, the surface and the radius by default."""
    table = read_table(write_folder(tmp_path))

    assert [item.name for item in table.objects] == ["box"]
    np.testing.assert_array_equal(table.pushers, [[-0.06, 0.01, 0.0, 0.05]])
    np.testing.assert_array_equal(table.outcomes, [[0.04, 0.001, -0.3]])
    assert table.pusher_radius_m.tolist() == [0.00475]
    assert table.surfaces == ("unstated",)


@pytest.mark.parametrize(
    ("column", "angle", "read"),
    [
        ("push_angle_rad", 12.0, 12.0 - 4.0 * np.pi),
        ("push_angle_rad", 90.0, 90.0),
        ("object_yaw_rad", 6.0, 6.0 - 2.0 * np.pi),
        ("object_yaw_rad", 12.0, 12.0),
    ],
)
def test_angles_are_wrapped_unless_they_may_be_degrees(tmp_path: Path, column: str, angle: float, read: float) -> None:
    """Wrap push angles of up to two turns and yaws of up to one, and leave larger ones for the check to find."""
    table = read_table(write_folder(tmp_path, [{**PUSH, column: angle}]))
    found = {"push_angle_rad": table.pushers[0, 2], "object_yaw_rad": table.outcomes[0, 2]}
    assert found[column] == pytest.approx(read)


@pytest.mark.parametrize(
    ("name", "meant"),
    [("pusher_radius_mm", "pusher_radius_m"), ("tip_radius", "pusher_radius_m"), ("Surface", "surface")],
)
def test_another_name_of_an_optional_column_is_refused(tmp_path: Path, name: str, meant: str) -> None:
    """Name the column to rename, because the default would be taken in silence."""
    folder = write_folder(tmp_path, [{**PUSH, name: 6}])
    assert fault_of(folder).endswith(f"has a column {name!r}, and none called {meant}; rename it to {meant}")


def test_the_recorded_pushes_layout_is_read_unchanged(tmp_path: Path) -> None:
    """Read the columns shape and surface, a peer's predictions, another column, and outlines.csv."""
    push = {"surface": "abs", "shape": "box", "speed_mm_s": 10, **PUSH}
    del push["object"]
    push |= {"poly4_x_m": 0.03, "poly4_y_m": 0.0, "poly4_yaw_rad": 0.1}
    corners = [{"shape": row.pop("object"), **row} for row in corner_rows()]
    (tmp_path / "pushes.csv").write_text(csv_text([push, {**push, "surface": "plywood"}]))
    (tmp_path / "outlines.csv").write_text(csv_text(corners))

    table = read_table(tmp_path)
    assert table.surfaces == ("abs", "plywood")
    assert table.labels["speed_mm_s"].values == ("10",)
    np.testing.assert_array_equal(table.peers["poly4"], [[0.03, 0.0, 0.1]] * 2)


def fault_of(folder: Path) -> str:
    """Return the one line in which reading a folder ends."""
    with pytest.raises(DataError) as caught:
        read_table(folder)
    (line,) = str(caught.value).splitlines()
    return line


@pytest.mark.parametrize("cell", ["nan", "inf", "1e400", "", "abc", "0x10", "0.5 m", "٣", '"0,5"'])
def test_a_cell_that_is_no_finite_number_is_named(tmp_path: Path, cell: str) -> None:
    """Name the file, the row as the table and as a spreadsheet count it, the column and the cell."""
    folder = write_folder(tmp_path, [PUSH, {**PUSH, "pusher_y_m": cell}])
    assert fault_of(folder).startswith(f"{folder / 'pushes.csv'}: row 2 (line 3), column pusher_y_m: received ")


def test_white_space_around_a_number_does_no_harm(tmp_path: Path) -> None:
    """Read numbers and names with white space around them, as tables typed by hand have."""
    table = read_table(write_folder(tmp_path, [{**PUSH, "object": " box ", "pusher_y_m": " 0.5 "}]))
    assert table.pushers[0, 1] == 0.5


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"push_length_m": -0.05}, "column push_length_m: received -0.05; accepted is a positive number"),
        ({"pusher_radius_m": 0}, "column pusher_radius_m: received 0; accepted is a positive number"),
        ({"object": "bix"}, "received 'bix', which has no outline in"),
        ({"object": ""}, "column object: received an empty cell; accepted is a name"),
        ({"object": "b" * 5000}, "of 5000 characters; accepted is up to"),
        ({"object": "\x1b[31mbox"}, r"received '\x1b[31mbox'"),
    ],
)
def test_a_value_that_no_push_has_is_named(tmp_path: Path, changed: dict[str, object], words: str) -> None:
    """Name a push backwards, a tip without size, and an object without an outline, a name or an end."""
    assert words in fault_of(write_folder(tmp_path, [{**PUSH, **changed}]))


def test_the_nearest_name_of_an_object_is_suggested(tmp_path: Path) -> None:
    """Suggest the object whose name is nearest to one without an outline."""
    assert fault_of(write_folder(tmp_path, [{**PUSH, "object": "bix"}])).endswith("'box' perhaps")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("pusher_x_m", "Pusher X m", "has no column pusher_x_m; rename 'Pusher X m' to pusher_x_m"),
        ("push_length_m", "speed", "has no column push_length_m; add it"),
        ("pusher_y_m", "pusher_x_m", "has 2 columns 'pusher_x_m'; remove all but one"),
    ],
)
def test_a_missing_column_is_named_with_the_nearest(tmp_path: Path, old: str, new: str, words: str) -> None:
    """Name a column that is missing, misspelt or doubled, and the way to correct it."""
    path = write_folder(tmp_path) / "pushes.csv"
    path.write_text(path.read_text().replace(old, new))
    assert words in fault_of(tmp_path)


def test_a_table_without_rows_is_refused(tmp_path: Path) -> None:
    """Refuse a header alone, and an empty file."""
    path = write_folder(tmp_path) / "pushes.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    assert "has a header and no pushes" in fault_of(tmp_path)
    path.write_text("")
    assert "is empty" in fault_of(tmp_path)


def test_empty_rows_at_the_end_are_skipped(tmp_path: Path) -> None:
    """Skip empty rows behind the last push, as spreadsheets leave them, and refuse one before it."""
    path = write_folder(tmp_path) / "pushes.csv"
    header, push = path.read_text().splitlines()
    path.write_text(f"{header}\n{push}\n\n,,,,,,,\n")
    assert read_table(tmp_path).count == 1
    path.write_text(f"{header}\n{push}\n\n{push}\n")
    assert "row 2 (line 3) is empty, and rows follow; delete it" in fault_of(tmp_path)


def test_a_column_of_too_many_values_is_left_out(tmp_path: Path) -> None:
    """Keep a column of a few texts to split by, and name one of a different number in every row as not read."""
    pushes = [{**PUSH, "run": number % 2, "time_s": 0.25 * number} for number in range(1200)]
    table = read_table(write_folder(tmp_path, pushes))
    assert list(table.labels) == ["run"]
    assert table.ignored == ("time_s",)


def test_the_digest_is_of_the_content(tmp_path: Path) -> None:
    """Return another digest for another number, and the same one for another peer or label."""
    first = read_table(write_folder(tmp_path / "a"))
    labelled = read_table(write_folder(tmp_path / "b", [{**PUSH, "run": "x"}]))
    other = read_table(write_folder(tmp_path / "c", [{**PUSH, "pusher_x_m": -0.061}]))
    assert first.digest == labelled.digest != other.digest
