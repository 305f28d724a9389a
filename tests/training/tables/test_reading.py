"""Reading of tables: numbers, names, aliases, other columns, and faults in one line each."""

from pathlib import Path

import numpy as np

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
