"""Parquet files of pushes: read a chunk of rows at a time, and written again with prediction columns."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from service.bulk.chunk import CHUNK_ROWS, CONTEXT_COLUMNS, POSE_COLUMNS, PREDICTED_COLUMNS, Chunk
from service.errors import DataError
from service.files import check_regular
from service.model.manifest import Manifest
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import VISUAL_SIZE

GROUP_CHUNKS: Final = 8
_CONTEXT_TYPES: Final = {ContextKind.INDICATOR: "text", ContextKind.VISUAL: f"{VISUAL_SIZE**2} bytes"}


class PushFile:
    """A Parquet file of pushes. Only its metadata is read until ``batches`` is called."""

    def __init__(self, path: Path) -> None:
        """Open the file and check the columns that every model needs.

        Raises:
            DataError: the file is not Parquet, lacks a pose column, or has a prediction column already.
        """
        self.path = path
        try:
            check_regular(path, path.stat().st_mode)  # to open a pipe would hang
            self._file = pq.ParquetFile(path)
        except (OSError, UnicodeError, pa.ArrowException) as error:
            reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
            raise DataError(
                f"{path}: received a file that cannot be read as Parquet ({reason}); accepted is a Parquet file"
            ) from error
        self.schema: pa.Schema = self._file.schema_arrow
        self.rows: int = self._file.metadata.num_rows
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
            received, accepted = " and ".join(CONTEXT_COLUMNS.values()), "one of them, or a model named with --model"
            raise DataError(f"{self.path}: received columns {received}; accepted is {accepted}")
        return found[0] if found else ContextKind.NONE

    def columns_for(self, kind: ContextKind) -> list[str]:
        """Return the names of the columns that a model of this kind needs.

        Raises:
            DataError: the context column is missing, or has another type.
        """
        if kind is ContextKind.NONE:
            return [*POSE_COLUMNS]
        fits = _is_text if kind is ContextKind.INDICATOR else _is_bytes
        self._must_have(CONTEXT_COLUMNS[kind], fits, f"a column of {_CONTEXT_TYPES[kind]}, one object per push")
        return [*POSE_COLUMNS, CONTEXT_COLUMNS[kind]]

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Read all rows and columns, ``CHUNK_ROWS`` rows at a time.

        Raises:
            DataError: the file is damaged.
        """
        try:
            yield from self._file.iter_batches(CHUNK_ROWS, use_threads=False)
        except (OSError, pa.ArrowException) as error:
            raise DataError(f"{self.path}: is damaged: {str(error).splitlines()[0]}") from error

    def _must_have(self, name: str, fits: Any, accepted: str) -> None:
        if self.schema.names.count(name) != 1:
            received = f"{self.schema.names.count(name)} columns {name} among {', '.join(self.schema.names) or 'none'}"
            raise DataError(f"{self.path}: received {received}; accepted is {accepted} of that name")
        kind = self.schema.field(name).type
        if not fits(kind.value_type if pa.types.is_dictionary(kind) else kind):
            raise DataError(f"{self.path}: column {name}: received {kind}; accepted is {accepted}")


def chunk_of(first_row: int, batch: pa.RecordBatch) -> Chunk:
    """Convert a batch with exactly the columns of one kind of model to a chunk."""
    columns = [batch.column(name) for name in POSE_COLUMNS]
    empty = np.column_stack([column.is_null().to_numpy(zero_copy_only=False) for column in columns])
    poses = np.column_stack([_numbers(column) for column in columns])
    contexts: tuple[str | bytes | None, ...] = ()
    context_index: IndexArray | None = None
    for name in set(CONTEXT_COLUMNS.values()) & set(batch.schema.names):
        given = _plain(batch.column(name)).dictionary_encode(null_encoding="encode")
        contexts, context_index = tuple(given.dictionary.to_pylist()), given.indices.to_numpy().astype(np.int64)
    return Chunk(first_row, poses, empty, contexts, context_index)


class PredictionFile:
    """A table of pushes with predictions, written a group of rows at a time.

    Its metadata name the model, the version and the frame.
    """

    def __init__(self, opened: IO[bytes], schema: pa.Schema, model: Manifest) -> None:
        metadata = {"cazsl.model": model.name, "cazsl.version": str(model.version), "cazsl.frame": "object"}
        for name in PREDICTED_COLUMNS:
            schema = schema.append(pa.field(name, pa.float32(), nullable=False))
        self._schema = schema.with_metadata({**(schema.metadata or {}), **metadata})
        self._writer = pq.ParquetWriter(opened, self._schema)
        self._waiting: list[pa.RecordBatch] = []

    def write(self, batch: pa.RecordBatch, found: FloatArray) -> None:
        """Add rows with their predictions, (n, 6)."""
        predicted = [pa.array(column) for column in np.ascontiguousarray(found.T)]
        self._waiting.append(pa.RecordBatch.from_arrays([*batch.columns, *predicted], schema=self._schema))
        if len(self._waiting) == GROUP_CHUNKS:
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


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _is_bytes(kind: pa.DataType) -> bool:
    return bool(pa.types.is_binary(kind) or pa.types.is_large_binary(kind) or pa.types.is_fixed_size_binary(kind))
