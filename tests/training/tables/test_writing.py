"""Writing of tables: a written table is read back to the bit in both formats."""

from pathlib import Path

import numpy as np
import pytest

from tests.training.tables.tables import PUSH, write_folder
from training.tables.reading import read_table
from training.tables.writing import Format, write_table


@pytest.mark.parametrize("file_format", ["csv", "parquet"])
def test_a_written_table_is_read_back(tmp_path: Path, file_format: Format) -> None:
    """Write a table in each format: its digest, peers, labels and source are those of the first."""
    push = {**PUSH, "pusher_x_m": -0.1 / 3, "run": "a", "mine_x_m": 0.1, "mine_y_m": 0.2, "mine_yaw_rad": 0.3}
    table = read_table(write_folder(tmp_path / "one", [push, {**push, "run": "b"}]))

    write_table(tmp_path / "two", table, file_format, {"source": "a test"})
    again = read_table(tmp_path / "two")
    assert again.digest == table.digest
    assert again.source == "a test"
    assert again.labels["run"].values == ("a", "b")
    np.testing.assert_array_equal(again.peers["mine"], table.peers["mine"])
