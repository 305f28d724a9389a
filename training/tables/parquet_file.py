"""Parquet files of a table, read as batches of columns whose memory is bounded before they are decoded.

The bound of a page is its header (``service.bulk.parquet_pages``). Texts are read as they are stored, each distinct
value once.
"""

from collections.abc import Iterator
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from service.bulk.parquet_pages import read_chunks, read_pages
from service.errors import DataError
from training.tables.files import Header, TableFile

BATCH_ROWS: Final = 1 << 16
MAX_COLUMNS: Final = 1000
MAX_PAGES_BYTES: Final = 256 << 20  # the largest pages of all columns that are read, in sum
_BUFFER_BYTES: Final = 1 << 20


def parquet_header(file: TableFile) -> Header:
    """Return the columns of a Parquet file whose footer promises no more rows than are accepted.

    Raises:
        DataError: the file is not Parquet, is cut, or has too many rows or columns.
    """
    try:
        found = pq.ParquetFile(file.path)
        schema, rows = found.schema_arrow, found.metadata.num_rows
    except (OSError, UnicodeError, pa.ArrowException) as error:
        raise _unreadable(file, error) from error
    if rows > file.max_rows:
        raise file.too_many_rows(str(rows))
    if len(schema) > MAX_COLUMNS:
        raise file.fault(f"received {len(schema)} columns; accepted are up to {MAX_COLUMNS}: leave others out")
    return Header(tuple(schema.names), frozenset(field.name for field in schema if _is_plain(field.type)))


def parquet_batches(file: TableFile, wanted: tuple[str, ...]) -> Iterator[pa.RecordBatch]:
    """Yield some columns of a Parquet file, at most ``BATCH_ROWS`` rows at a time.

    Raises:
        DataError: a column holds lists or bytes, the file is damaged, or its pages take too much memory.
    """
    try:
        schema = pq.ParquetFile(file.path).schema_arrow
        for name in wanted:
            kind = schema.field(name).type
            if not _is_plain(kind):
                raise file.fault(f"column {name}: received {kind}; accepted is a column of numbers or of text")
        texts = [name for name in wanted if _is_text(schema.field(name).type)]
        opened = pq.ParquetFile(file.path, read_dictionary=texts, buffer_size=_BUFFER_BYTES)
        _check_pages(file, opened, wanted)
        for batch in opened.iter_batches(BATCH_ROWS, columns=list(wanted), use_threads=False):
            batch.validate(full=True)  # texts and indices of a damaged file would be read outside of their memory
            yield batch
    except (OSError, UnicodeError, pa.ArrowException) as error:
        raise _unreadable(file, error) from error


def _check_pages(file: TableFile, opened: pq.ParquetFile, wanted: tuple[str, ...]) -> None:
    """Refuse pages that are too large to be open at a time, by the headers of all pages."""
    names = [opened.schema.column(number).path for number in range(len(opened.schema.names))]
    largest = dict.fromkeys(wanted, 0)
    for chunks in read_chunks(file.path):
        for name, chunk in zip(names, chunks, strict=False):
            if name in largest:
                sizes = (page.size for page in read_pages(file.path, chunk.start, chunk.size))
                largest[name] = max(largest[name], *sizes, 0)
    if sum(largest.values()) > MAX_PAGES_BYTES:
        name = max(largest, key=lambda name: largest[name])
        received = f"pages of {sum(largest.values()) >> 20} MiB, {largest[name] >> 20} MiB in column {name}"
        raise file.fault(f"received {received}; accepted are {MAX_PAGES_BYTES >> 20} MiB: write smaller pages")


def _unreadable(file: TableFile, error: Exception) -> DataError:
    reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
    return file.fault(f"cannot be read as Parquet, perhaps because it was cut ({reason}); write or copy it again")


def _is_text(kind: pa.DataType) -> bool:
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return any(fits(kind) for fits in (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view))


def _is_plain(kind: pa.DataType) -> bool:
    types = pa.types
    return _is_text(kind) or any(fits(kind) for fits in (types.is_floating, types.is_integer, types.is_decimal))
