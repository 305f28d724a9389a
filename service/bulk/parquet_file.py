"""Parquet files of pushes: read a chunk of rows at a time, and written again with prediction columns.

A file may be small and become huge, so its memory is bounded before and while it is decoded. The pages of all columns
that are open at a time are bounded by their headers, and rows that are read at a time by the densest page. Texts and
bytes are read as they are stored, each distinct value once, and become values of their own a bounded part at a time.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from service.bulk.chunk import (
    CHUNK_ROWS,
    CONTEXT_COLUMNS,
    LENGTH_COLUMN,
    NUMBER_COLUMNS,
    POSE_COLUMNS,
    PREDICTED_COLUMNS,
    WARNINGS_COLUMN,
    Chunk,
    ChunkPredictions,
)
from service.bulk.parquet_pages import read_chunks, read_pages
from service.errors import DataError
from service.files import check_regular
from service.model.manifest import Manifest
from service.model.tensors import ContextKind, IndexArray
from service.pushing.contexts import VISUAL_SIZE
from service.pushing.poses import PUSH_LENGTH_M

GROUP_CHUNKS: Final = 8
MAX_ROWS: Final = 1 << 30
MAX_COLUMNS: Final = 1000
MAX_PAGES_BYTES: Final = 256 << 20  # the largest page of every column. Writers make pages of about 1 MiB.
PART_BYTES: Final = 16 << 20  # rows that are read or become values at a time
GROUP_BYTES: Final = 64 << 20  # a group of rows is written at this size, if it has not ``GROUP_CHUNKS`` before
_BUFFER_BYTES: Final = 1 << 20  # of a column. Without a buffer all of its chunk is read at once.
_CONTEXT_TYPES: Final = {
    ContextKind.INDICATOR: "text",
    ContextKind.VISUAL: f"{VISUAL_SIZE**2} bytes",
    ContextKind.SHAPE: "text, JSON of a shape",
    ContextKind.SUPPORT: "text, JSON of a support",
}


class PushFile:
    """A Parquet file of pushes. Only its metadata is read until ``batches`` is called."""

    def __init__(self, path: Path, max_pages_bytes: int = MAX_PAGES_BYTES) -> None:
        """Open the file and check the columns that every model needs.

        Args:
            path: the file.
            max_pages_bytes: maximum of the pages that are open at a time, in bytes.

        Raises:
            DataError: the file is not Parquet, lacks a pose column, or has a prediction column already.
        """
        self.path = path
        self._max_pages_bytes = max_pages_bytes
        try:
            check_regular(path, path.stat().st_mode)  # to open a pipe would hang
            found = pq.ParquetFile(path)
            self.schema: pa.Schema = found.schema_arrow
            self._file = pq.ParquetFile(path, read_dictionary=_stored_once(self.schema), buffer_size=_BUFFER_BYTES)
        except (OSError, UnicodeError, pa.ArrowException) as error:
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            raise DataError(
                f"{path}: received a file that cannot be read as Parquet ({reason}); accepted is a Parquet file"
            ) from error
        self.rows: int = self._file.metadata.num_rows
        self._check_bounds()
        for name in POSE_COLUMNS:
            self._must_have(name, _is_number, "a column of numbers")
        for name in PREDICTED_COLUMNS:
            if name in self.schema.names:
                raise DataError(f"{path}: received column {name}; accepted is a table without it, because it is added")

    def kind(self) -> ContextKind:
        """Return the kind of context that the columns hold.

        Raises:
            DataError: there is more than one context column.
        """
        found = [kind for kind, name in CONTEXT_COLUMNS.items() if name in self.schema.names]
        if len(found) > 1:
            received = " and ".join(CONTEXT_COLUMNS[kind] for kind in found)
            accepted = "one of them, or a model named with --model"
            raise DataError(f"{self.path}: received columns {received}; accepted is {accepted}")
        return found[0] if found else ContextKind.NONE

    def columns_for(self, kind: ContextKind) -> list[str]:
        """Return the names of the columns that a model of this kind needs.

        Raises:
            DataError: the context column is missing, or has another type.
        """
        pushes = [*POSE_COLUMNS]
        if LENGTH_COLUMN in self.schema.names:
            self._must_have(LENGTH_COLUMN, _is_number, "a column of numbers")
            pushes.append(LENGTH_COLUMN)
        if kind is ContextKind.NONE:
            return pushes
        fits = _is_bytes if kind is ContextKind.VISUAL else _is_text
        self._must_have(CONTEXT_COLUMNS[kind], fits, f"a column of {_CONTEXT_TYPES[kind]}, one object per push")
        return [*pushes, CONTEXT_COLUMNS[kind]]

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Read all rows and columns, at most ``CHUNK_ROWS`` rows and about ``PART_BYTES`` at a time.

        Raises:
            DataError: the file is damaged, or its pages take more memory than ``max_pages_bytes``.
        """
        try:
            for stored in self._file.iter_batches(self._rows_at_a_time(), use_threads=False):
                for part in _parts(stored):
                    yield _values(part, self.schema)
        except (OSError, pa.ArrowException) as error:
            raise DataError(f"{self.path}: is damaged: {str(error).splitlines()[0]}") from error

    def _check_bounds(self) -> None:
        """Refuse rows and columns that no bound of memory would hold for."""
        if self.rows > MAX_ROWS:
            raise DataError(f"{self.path}: received {self.rows} rows; accepted are up to {MAX_ROWS} in one file")
        if len(self.schema) > MAX_COLUMNS:
            raise DataError(f"{self.path}: received {len(self.schema)} columns; accepted are up to {MAX_COLUMNS}")
        for field in self.schema:
            is_extension = isinstance(field.type, pa.BaseExtensionType)
            kind = field.type.storage_type if is_extension else field.type
            if pa.types.is_nested(kind) or (is_extension and _has_length(kind)):
                accepted = "a column of single values of a plain type, because rows of others have no bound"
                raise DataError(f"{self.path}: column {field.name}: received {field.type}; accepted is {accepted}")

    def _rows_at_a_time(self) -> int:
        """Return the number of rows whose pages hold ``PART_BYTES``, by the headers of all pages.

        Raises:
            DataError: see ``batches``.
        """
        metadata = self._file.metadata
        largest, densest = [0] * metadata.num_columns, [0.0] * metadata.num_columns
        for chunks in read_chunks(self.path):
            for column, chunk in enumerate(chunks[: metadata.num_columns]):
                for page in read_pages(self.path, chunk.start, chunk.size):
                    largest[column] = max(largest[column], page.size)
                    densest[column] = max(densest[column], page.size / max(1, page.values))
        if sum(largest) > self._max_pages_bytes:
            place = largest.index(max(largest))
            name = self._file.schema.column(place).name
            received = f"pages of {sum(largest) >> 20} MiB in all columns, {largest[place] >> 20} MiB in column {name}"
            accepted = f"up to {self._max_pages_bytes >> 20} MiB: write it again with smaller pages or fewer columns"
            raise DataError(f"{self.path}: received {received}; accepted are {accepted}")
        fixed = sum(field.type.byte_width for field in self.schema if pa.types.is_fixed_size_binary(field.type))
        return max(1, min(CHUNK_ROWS, int(PART_BYTES / max(1.0, fixed + sum(densest)))))

    def _must_have(self, name: str, fits: Any, accepted: str) -> None:
        if self.schema.names.count(name) != 1:
            received = f"{self.schema.names.count(name)} columns {name} among {', '.join(self.schema.names) or 'none'}"
            raise DataError(f"{self.path}: received {received}; accepted is {accepted} of that name")
        kind = self.schema.field(name).type
        if not fits(kind.value_type if pa.types.is_dictionary(kind) else kind):
            raise DataError(f"{self.path}: column {name}: received {kind}; accepted is {accepted}")


def _stored_once(schema: pa.Schema) -> list[str]:
    """Return the names of the columns of texts and bytes, whose values may be long and are stored once each."""
    return [field.name for field in schema if _is_text(field.type) or _is_bytes(field.type)]


def _parts(batch: pa.RecordBatch) -> Iterator[pa.RecordBatch]:
    """Cut a batch into parts of at most ``PART_BYTES``, or one row, once every value stands for itself."""
    sizes = np.zeros(batch.num_rows, dtype=np.int64)
    for column in batch.columns:
        if isinstance(column, pa.DictionaryArray):
            lengths = pc.binary_length(column.dictionary) if _has_length(column.type.value_type) else None
            if lengths is not None and len(lengths):
                sizes += pc.fill_null(pc.take(lengths, column.indices), 0).to_numpy(zero_copy_only=False)
    ends = np.cumsum(sizes)
    begin = 0
    while begin < batch.num_rows:
        before = int(ends[begin - 1]) if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, before + PART_BYTES, side="right")))
        yield batch.slice(begin, end - begin)
        begin = end


def _values(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return a batch whose columns have the types of a schema, where they were read as they are stored."""
    columns = [
        column if column.type == field.type else _plain(column).cast(field.type)
        for column, field in zip(batch.columns, schema, strict=True)
    ]
    return pa.RecordBatch.from_arrays(columns, schema=schema)


def chunk_of(first_row: int, batch: pa.RecordBatch) -> Chunk:
    """Convert a batch with exactly the columns of one kind of model to a chunk."""
    has_lengths = LENGTH_COLUMN in batch.schema.names
    columns = [batch.column(name) for name in (*POSE_COLUMNS, LENGTH_COLUMN)[: 3 + has_lengths]]
    empty = np.zeros((batch.num_rows, 4), dtype=np.bool_)
    pushes = np.full((batch.num_rows, 4), PUSH_LENGTH_M)
    for number, column in enumerate(columns):
        empty[:, number] = column.is_null().to_numpy(zero_copy_only=False)
        pushes[:, number] = _numbers(column)
    contexts: tuple[str | bytes | None, ...] = ()
    context_index: IndexArray | None = None
    for name in set(CONTEXT_COLUMNS.values()) & set(batch.schema.names):
        given = _encodable(_plain(batch.column(name))).dictionary_encode(null_encoding="encode")
        contexts, context_index = tuple(given.dictionary.to_pylist()), given.indices.to_numpy().astype(np.int64)
    return Chunk(first_row, pushes, empty, contexts, context_index)


class PredictionFile:
    """A table of pushes with predictions, written a group of rows at a time.

    Its metadata name the model, the version and the frame.
    """

    def __init__(self, opened: IO[bytes], schema: pa.Schema, model: Manifest) -> None:
        metadata = {"cazsl.model": model.name, "cazsl.version": str(model.version), "cazsl.frame": "object"}
        for name in NUMBER_COLUMNS:
            schema = schema.append(pa.field(name, pa.float32(), nullable=False))
        schema = schema.append(pa.field(WARNINGS_COLUMN, pa.string(), nullable=False))
        self._schema = schema.with_metadata({**(schema.metadata or {}), **metadata})
        self._writer = pq.ParquetWriter(opened, self._schema)
        self._waiting: list[pa.RecordBatch] = []

    def write(self, batch: pa.RecordBatch, found: ChunkPredictions) -> None:
        """Add rows with their predictions."""
        predicted = [pa.array(column) for column in np.ascontiguousarray(found.numbers.T)]
        predicted.append(pa.array(found.warnings, pa.string()))
        self._waiting.append(pa.RecordBatch.from_arrays([*batch.columns, *predicted], schema=self._schema))
        if len(self._waiting) == GROUP_CHUNKS or sum(waiting.nbytes for waiting in self._waiting) >= GROUP_BYTES:
            self._write_group()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, fault: type[BaseException] | None, *_: object) -> None:
        """Write the remaining rows, unless the block failed, and the end of the file."""
        if fault is None and self._waiting:
            self._write_group()
        with contextlib.suppress(*([] if fault is None else [OSError])):  # a full disk is reported by the fault already
            self._writer.close()

    def _write_group(self) -> None:
        self._writer.write_table(pa.Table.from_batches(self._waiting, self._schema))
        self._waiting = []


def _numbers(column: pa.Array) -> Any:
    return _plain(column).cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)


def _plain(column: pa.Array) -> pa.Array:
    return column.dictionary_decode() if isinstance(column, pa.DictionaryArray) else column


def _encodable(column: pa.Array) -> pa.Array:
    """Return a column of views as one of texts or bytes, for which the library has more functions."""
    if pa.types.is_string_view(column.type):
        return column.cast(pa.large_string())
    return column.cast(pa.large_binary()) if pa.types.is_binary_view(column.type) else column


def _has_length(kind: pa.DataType) -> bool:
    return _is_text(kind) or _is_bytes(kind)


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def _is_text(kind: pa.DataType) -> bool:
    return any(fits(kind) for fits in (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view))


def _is_bytes(kind: pa.DataType) -> bool:
    types = pa.types
    return any(
        fits(kind)
        for fits in (types.is_binary, types.is_large_binary, types.is_fixed_size_binary, types.is_binary_view)
    )
