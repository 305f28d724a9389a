"""A Parquet file is read in bounded memory, whatever it becomes, and every kind of text is text."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner, Result

from service.bulk.chunk import CHUNK_ROWS, ChunkPredictions
from service.bulk.parquet_file import MAX_COLUMNS, PART_BYTES, PredictionFile, PushFile
from service.cli.main import main
from service.errors import DataError
from tests.fakes import draft_manifest

LONG = "a" * 1_000_000


def table(rows: int, **columns: Any) -> pa.Table:
    """Make a table of pushes of one object."""
    zeros = np.zeros(rows)
    return pa.table({"x_m": zeros, "y_m": zeros, "angle_rad": zeros, "descriptor": ["1a2b3c4a"] * rows, **columns})


def file_of(folder: Path, pushes: pa.Table, **options: Any) -> Path:
    """Write a table."""
    path = folder / "in.parquet"
    pq.write_table(pushes, path, **{"compression": "zstd", **options})
    return path


def repeated(rows: int, value: str | bytes) -> pa.Array:
    """Return a column that stores one value for all rows."""
    return pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), [value])


def own_bytes(batch: pa.RecordBatch) -> int:
    """Return the memory of a batch if each value stands for itself."""
    return sum(
        (column.dictionary_decode() if isinstance(column, pa.DictionaryArray) else column).nbytes
        for column in batch.columns
    )


GIGABYTES = {
    "one text for all rows": {"columns": {"note": repeated(7000, LONG)}},
    "one text, without the types of Arrow": {"columns": {"note": repeated(7000, LONG)}, "store_schema": False},
    "one descriptor for all rows": {"columns": {"descriptor": repeated(7000, LONG)}, "store_schema": False},
    "bytes": {"columns": {"visual": repeated(7000, LONG.encode())}, "store_schema": False},
    "bytes of fixed size": {
        "columns": {"note": pa.array([bytes(20_000)] * 7000, pa.binary(20_000))},
        "store_schema": True,
    },
    "equal texts in large pages": {
        "columns": {"note": pa.array(["b" * 20_000] * 7000)},
        "use_dictionary": False,
        "data_page_size": 8 << 20,
    },
}


@pytest.mark.parametrize("case", GIGABYTES.values(), ids=GIGABYTES.keys())
def test_no_batch_becomes_large(tmp_path: Path, case: dict[str, Any]) -> None:
    """A small file that becomes gigabytes is read in parts, each of which is bounded, and all of its rows come."""
    options = {name: value for name, value in case.items() if name != "columns"}
    path = file_of(tmp_path, table(7000, **case["columns"]), **options)
    assert path.stat().st_size < 200_000
    rows = largest = 0
    for batch in PushFile(path).batches():
        rows += batch.num_rows
        largest = max(largest, own_bytes(batch))
        if rows > 500:  # enough of gigabytes
            break
    assert rows > 16
    assert largest <= 2 * PART_BYTES


def test_batches_of_usual_files_have_all_rows_of_a_chunk(tmp_path: Path) -> None:
    """The bounds do not change how a usual file is read."""
    path = file_of(tmp_path, table(CHUNK_ROWS + 5))
    batches = [*PushFile(path).batches()]
    assert [batch.num_rows for batch in batches] == [CHUNK_ROWS, 5]
    assert pa.Table.from_batches(batches).equals(pq.read_table(path))


def test_large_pages_are_refused_before_they_are_decoded(tmp_path: Path) -> None:
    """The error names the file, the column and the bound."""
    note = pa.array([f"{number}" * 3_000_000 for number in range(3)])
    path = file_of(tmp_path, table(3, note=note), use_dictionary=False, data_page_size=1 << 30)
    with pytest.raises(
        DataError, match=r"in\.parquet: received pages of 8 MiB .* 8 MiB in column note; .* up to 4 MiB"
    ):
        list(PushFile(path, max_pages_bytes=4 << 20).batches())
    assert len([*PushFile(path).batches()]) >= 1


def test_metadata_that_lie_do_not_help(tmp_path: Path) -> None:
    """The sizes that the end of a file declares for its columns are not believed."""
    note = pa.array(["a" * 9_000_000, "b"])
    path = file_of(tmp_path, table(2, note=note), use_dictionary=False, data_page_size=1 << 30)
    chunk = pq.read_metadata(path).row_group(0).column(4)
    content = path.read_bytes()
    declared = zigzag(chunk.total_uncompressed_size)
    assert content.count(declared) >= 1
    path.write_bytes(declared.join(content.split(declared)[:-1]) + zigzag(1 << 22) + content.split(declared)[-1])
    assert pq.read_metadata(path).row_group(0).column(4).total_uncompressed_size == 1 << 22
    with pytest.raises(DataError, match="8 MiB in column note"):
        list(PushFile(path, max_pages_bytes=6 << 20).batches())


def zigzag(value: int) -> bytes:
    """Encode a positive number as Thrift does."""
    rest, found = 2 * value, bytearray()
    while rest > 0x7F:
        found.append(rest & 0x7F | 0x80)
        rest >>= 7
    return bytes([*found, rest])


@pytest.mark.parametrize(
    "column",
    [
        pa.array([[0.5] * 9] * 4),
        pa.array([{"a": 1}] * 4),
        pa.array([[(1, 2)]] * 4, pa.map_(pa.int8(), pa.int8())),
        pa.FixedShapeTensorArray.from_numpy_ndarray(np.zeros((4, 2, 2))),
        pa.ExtensionArray.from_storage(pa.json_(), pa.array(["{}"] * 4)),
    ],
    ids=["list", "struct", "map", "tensor", "extension of text"],
)
def test_nested_columns_are_refused(tmp_path: Path, column: pa.Array) -> None:
    """A row of a nested column has no bound, so the column is refused by its name."""
    with pytest.raises(
        DataError, match=r"in\.parquet: column note: received .*; accepted is a column of single values"
    ):
        PushFile(file_of(tmp_path, table(4, note=column)))


def test_many_columns_are_refused(tmp_path: Path) -> None:
    """Each open column takes memory."""
    columns = {f"c{number}": np.zeros(1, dtype=np.int8) for number in range(MAX_COLUMNS)}
    with pytest.raises(DataError, match=rf"received {MAX_COLUMNS + 4} columns; accepted are up to {MAX_COLUMNS}"):
        PushFile(file_of(tmp_path, table(1, **columns)))


def test_large_rows_are_written_in_small_groups(tmp_path: Path) -> None:
    """The rows that wait to be written are bounded in bytes as well as in number."""
    path = file_of(tmp_path, table(200, note=repeated(200, LONG)), store_schema=False)
    source = PushFile(path)
    with (tmp_path / "out").open("wb") as opened, PredictionFile(opened, source.schema, draft_manifest()) as written:
        for batch in source.batches():
            numbers = np.zeros((batch.num_rows, 6), dtype=np.float32)
            written.write(batch, ChunkPredictions(numbers, [""] * batch.num_rows))
    assert pq.read_metadata(tmp_path / "out").num_row_groups > 1
    assert pq.read_table(tmp_path / "out", columns=["note"]).column(0).to_pylist() == [LONG] * 200


def predicted(folder: Path, registry: Path, pushes: pa.Table) -> Result:
    """Predict a table by the command."""
    arguments = ["predict", "--parquet", str(file_of(folder, pushes)), str(folder / "out.parquet"), "--jobs", "1"]
    return CliRunner().invoke(main, [*arguments, "--registry", str(registry)])


TEXTS = [pa.string(), pa.large_string(), pa.string_view()]
BYTES = [pa.binary(), pa.large_binary(), pa.binary_view(), pa.binary(1024)]
COLUMNS = {
    **{f"descriptor {kind}": ("descriptor", pa.array(["1a2b3c4a", "4a4a4a4a"] * 5, kind)) for kind in TEXTS},
    **{
        f"descriptor dictionary of {kind}": (
            "descriptor",
            pa.DictionaryArray.from_arrays(np.arange(10, dtype=np.int8) % 2, pa.array(["1a2b3c4a", "4a4a4a4a"], kind)),
        )
        for kind in TEXTS[:2]
    },
    **{f"visual {kind}": ("visual", pa.array([bytes(1024), b"\xff" * 1024] * 5, kind)) for kind in BYTES},
}


@pytest.mark.parametrize(("name", "column"), COLUMNS.values(), ids=COLUMNS.keys())
def test_every_kind_of_text_and_bytes_is_read_and_written(
    tmp_path: Path, project_root: Path, name: str, column: pa.Array
) -> None:
    """Texts and bytes of every type give the same predictions, and the column keeps its type in the result."""
    pushes = table(10).drop_columns("descriptor").append_column(name, column)
    result = predicted(tmp_path, project_root / "models", pushes)
    assert result.exit_code == 0, result.output
    found = pq.read_table(tmp_path / "out.parquet")
    assert found.column(name).equals(pq.read_table(tmp_path / "in.parquet").column(name))
    assert len(set(found["mean_x_m"].to_pylist())) == 2
