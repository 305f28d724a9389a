"""Parquet files of tables: types that are read, and bounds before anything is decoded."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.training.tables.tables import PUSH, fault_of, write_folder
from training.tables.files import MAX_PUSHES
from training.tables.reading import read_table


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The name of a file of pushes beside a valid file of objects."""
    (write_folder(tmp_path) / "pushes.csv").unlink()
    return tmp_path / "pushes.parquet"


def write(path: Path, columns: dict[str, Any], **options: Any) -> None:
    """Write one push, or more, with some columns replaced."""
    rows = max((len(column) for column in columns.values()), default=1)
    pq.write_table(pa.table({**{name: [value] * rows for name, value in PUSH.items()}, **columns}), path, **options)


@pytest.mark.parametrize(
    "columns",
    [
        {"pusher_x_m": pa.array([1], pa.int32())},
        {"pusher_x_m": pa.array([0.5], pa.float16())},
        {"pusher_x_m": [" 0.5 "]},
        {"object": pa.array(["box"]).dictionary_encode()},
        {"object": pa.array(["box"], pa.large_string())},
        {"times_s": [[1.0, 2.0]]},
    ],
    ids=["int32", "float16", "text", "categories", "large text", "a list that is not read"],
)
def test_columns_of_other_types_are_read(path: Path, columns: dict[str, Any]) -> None:
    """Read the types that other writers choose for numbers and names."""
    write(path, columns)
    assert read_table(path).count == 1


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"pusher_x_m": [float("nan")]}, "row 1, column pusher_x_m: received nan"),
        ({"pusher_x_m": pa.array([None], pa.float64())}, "row 1, column pusher_x_m: received an empty cell"),
        ({"pusher_x_m": ["left"]}, "row 1, column pusher_x_m: received 'left'"),
        ({"pusher_x_m": [[1.0]]}, "column pusher_x_m: received list<element: double>"),
        ({"object": pa.array([None], pa.string())}, "row 1, column object: received an empty cell"),
    ],
)
def test_cells_that_are_no_numbers_are_named(path: Path, columns: dict[str, Any], words: str) -> None:
    """Name the row, the column and the cell, or the type of the column."""
    write(path, columns)
    assert fault_of(path).startswith(words)


def test_a_file_that_was_cut_is_refused(path: Path) -> None:
    """Refuse a file without its end, one of other content, and one whose pages were overwritten."""
    write(path, {})
    content = path.read_bytes()
    for broken in (content[:-30], b"a,b\n1,2\n", content[:20] + b"\xff" * 40 + content[60:]):
        path.write_bytes(broken)
        assert "copy it again" in fault_of(path) or "is damaged" in fault_of(path)


def test_a_file_with_too_many_rows_is_refused_by_its_footer(path: Path) -> None:
    """Refuse more rows than a table may have before one of them is read: a file of 300 kB can hold ten million."""
    index = pa.array(np.zeros(MAX_PUSHES + 1, dtype=np.int32))
    numbers = pa.DictionaryArray.from_arrays(index, [1.0])
    columns = dict.fromkeys(PUSH, numbers) | {"object": pa.DictionaryArray.from_arrays(index, ["box"])}
    pq.write_table(pa.table(columns), path)
    assert (
        fault_of(path)
        == f"received {MAX_PUSHES + 1} rows; accepted are up to {MAX_PUSHES} pushes: split it into several tables"
    )


@pytest.mark.parametrize("column", ["object", "pusher_x_m"])
def test_a_long_text_for_many_rows_takes_memory_once(path: Path, column: str) -> None:
    """Name a text of 8 MiB that is stored once for 300,000 rows, which would be 2 TiB."""
    long = pa.DictionaryArray.from_arrays(pa.array(np.zeros(300_000, dtype=np.int32)), ["1" * (8 << 20)])
    write(path, {column: long}, dictionary_pagesize_limit=1 << 30)
    assert fault_of(path).startswith(f"row 1, column {column}: received '1111")


def test_a_page_beyond_the_bound_is_refused_by_its_header(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse pages that take more memory than is accepted, with the column."""
    monkeypatch.setattr("training.tables.parquet_file.MAX_PAGES_BYTES", 1 << 20)
    write(path, {"object": ["b" * (2 << 20)]})
    assert "2 MiB in column object" in fault_of(path)
