"""Columns of a table as arrays: names checked, cells converted, and the first faulty cell named.

Rows come in batches, so that memory grows with the result alone. A cell is converted once, by the library. Only after a
fault a batch is searched for the cell.
"""

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from service.errors import DataError
from service.pushing.poses import DoubleArray
from training.tables.csv_file import csv_batches, csv_header
from training.tables.files import Header, TableFile
from training.tables.parquet_file import parquet_batches, parquet_header
from training.tables.push_table import IndexArray, TextColumn

LARGEST: Final = 1e6  # of any number: metres, radians, kilograms
MAX_NAME: Final = 200  # characters of a text
MAX_VALUES: Final = 100_000  # distinct values of a column of names, which are objects or surfaces
MAX_LABELS: Final = 1_000  # distinct values of another column. Columns with more are not read.
_SHOWN: Final = 40  # characters of a cell in a message
_UNITS: Final = {"_m": "a number in metres", "_rad": "a number in radians", "_kg": "a number in kilograms"}


@dataclass(frozen=True)
class Wanted:
    """Columns to read: numbers, numbers whose cells may be empty, names, and labels."""

    numbers: tuple[str, ...]
    optional: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        """Names of all columns, each once."""
        return tuple(dict.fromkeys((*self.names, *self.numbers, *self.optional, *self.labels)))


@dataclass(frozen=True)
class Columns:
    """Columns of n rows: numbers, (n,), NaN for an empty cell of an optional one; texts; and labels not kept."""

    rows: int
    numbers: Mapping[str, DoubleArray]
    texts: Mapping[str, TextColumn]
    dropped: tuple[str, ...]


def read_header(file: TableFile) -> Header:
    """Check a file and return its columns.

    Raises:
        DataError: the file is missing, too large or of another kind, or a name occurs twice.
    """
    file.check()
    header = csv_header(file) if file.is_csv else parquet_header(file)
    for name in header.names:
        if header.names.count(name) > 1:
            raise file.fault(f"has {header.names.count(name)} columns {name!r}; remove all but one")
    return header


def require(file: TableFile, header: Header, names: Iterable[str]) -> None:
    """Check that a file has columns.

    Raises:
        DataError: a column is missing. The message names the nearest one, and the names that are there.
    """
    if not any(header.names):
        raise file.fault("has an empty first line; expected the names of the columns there")
    wanted = tuple(names)
    missing = [name for name in wanted if name not in header.names]
    if missing:
        folded = {name.lower().replace(" ", "_"): name for name in header.names if name not in wanted}
        near = difflib.get_close_matches(missing[0], folded, n=1, cutoff=0.7)
        advice = f"rename {folded[near[0]]!r} to {missing[0]}" if near else "add it"
        there = ", ".join(header.names[:20])
        raise file.fault(f"has no column {', '.join(missing)}; {advice} (there are: {there[:300]}; see docs/data.md)")


def read_columns(file: TableFile, header: Header, wanted: Wanted) -> Columns:
    """Read columns of a file.

    Raises:
        DataError: a row or a cell is not as expected. The message names it.
    """
    batches = csv_batches(file, header.names, wanted.all) if file.is_csv else parquet_batches(file, wanted.all)
    collector = _Collector(file, wanted)
    for batch in batches:
        collector.add(batch.rename_columns(list(wanted.all)))
    if not collector.rows:
        raise file.fault(f"has a header and no {file.rows}; add one row for each")
    return collector.columns()


@dataclass
class _Names:
    """Distinct texts of a column by their index, and the indices of the rows, in parts. None: too many to keep."""

    known: dict[str, int] = field(default_factory=dict)
    parts: list[IndexArray] = field(default_factory=list)


class _Collector:
    """Columns of the batches so far."""

    def __init__(self, file: TableFile, wanted: Wanted) -> None:
        self.rows = 0
        self._file = file
        self._wanted = wanted
        self._numbers: dict[str, list[DoubleArray]] = {name: [] for name in (*wanted.numbers, *wanted.optional)}
        self._texts = {name: _Names() for name in (*wanted.names, *wanted.labels)}
        self._dropped: list[str] = []
        self._empty: int | None = None  # the first of the empty rows at the end of the batches so far

    def add(self, batch: pa.RecordBatch) -> None:
        """Add the rows of a batch."""
        batch = self._without_empty_end(batch)
        if self.rows + batch.num_rows > self._file.max_rows:
            raise self._file.too_many_rows(f"more than {self._file.max_rows}")
        for name, numbers in self._numbers.items():
            numbers.append(self._convert(name, batch.column(name)))
        for name in list(self._texts):
            self._add_texts(name, batch.column(name))
        self.rows += batch.num_rows

    def columns(self) -> Columns:
        """Return all rows. The parts are freed column by column."""
        numbers = {name: np.concatenate(self._numbers.pop(name)) for name in list(self._numbers)}
        texts = {
            name: TextColumn(tuple(found.known), np.concatenate(found.parts)) for name, found in self._texts.items()
        }
        return Columns(self.rows, numbers, texts, tuple(self._dropped))

    def _without_empty_end(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        """Return a batch without empty rows at its end, as spreadsheets leave them. One before a push is a fault."""
        if all(column.null_count for column in batch.columns):
            empty = np.logical_and.reduce([_mask(column.is_null()) for column in batch.columns])
            filled = np.flatnonzero(~empty)
            end = int(filled[-1]) + 1 if len(filled) else 0
        else:
            empty, end = np.zeros(0, dtype=np.bool_), batch.num_rows
        first = self._empty if self._empty is not None else _first(empty[:end], self.rows)
        if first is not None and end:
            line = f" (line {first + 2})" if self._file.is_csv else ""
            raise self._file.fault(f"row {first + 1}{line} is empty, and rows follow; delete it")
        if end < batch.num_rows and self._empty is None:
            self._empty = self.rows + end
        return batch.slice(0, end)

    def _convert(self, name: str, column: Any) -> DoubleArray:
        """Return the numbers of a column of a batch. Texts that are stored once are converted once."""
        distinct = column.dictionary if pa.types.is_dictionary(column.type) else column
        try:
            numbers = distinct.cast(pa.float64(), safe=False)
        except pa.ArrowException:  # white space around a number, or no number
            numbers = self._trimmed(name, column, distinct.cast(pa.large_string()))
        values: DoubleArray = numbers.to_numpy(zero_copy_only=False)
        if pa.types.is_dictionary(column.type):
            values = np.append(values, np.nan)[_codes(column)]
        is_optional = name in self._wanted.optional
        faulty = ~(np.abs(values) <= LARGEST)  # NaN too
        faulty &= ~np.isnan(values) if is_optional else True
        if faulty.any():
            row = int(faulty.argmax())
            cell = column[row].as_py()
            received = "an empty cell" if cell is None else _shown(cell)
            raise self._file.fault_at(self.rows + row, name, received, f"{_accepted(name)}, finite and under 1e6")
        return values

    def _trimmed(self, name: str, column: Any, distinct: Any) -> Any:
        """Return texts as numbers, without white space around them."""
        try:
            return pc.utf8_trim_whitespace(distinct).cast(pa.float64())
        except pa.ArrowException:
            for code in range(len(distinct)):
                cell = distinct[code].as_py()
                if cell is not None and not _is_number(cell):
                    comma = " with a point, not a comma" if _is_number(cell.replace(",", ".", 1)) else ""
                    row = self.rows + _row_of(column, code)
                    raise self._file.fault_at(row, name, _shown(cell), _accepted(name) + comma) from None
            raise

    def _add_texts(self, name: str, column: Any) -> None:
        """Add the texts of a column, or drop a column of labels that has too many distinct ones."""
        is_label = name not in self._wanted.names
        if not pa.types.is_dictionary(column.type):
            column = column.cast(pa.large_string()).dictionary_encode()
        found, index = self._texts[name], []
        for code in range(len(column.dictionary)):
            text = (column.dictionary[code].as_py() or "").strip()
            if len(text) > MAX_NAME or len(found.known) > (MAX_LABELS if is_label else MAX_VALUES):
                if is_label:
                    self._dropped.append(name)
                    del self._texts[name]
                    return
                limit = f"up to {MAX_VALUES} names of at most {MAX_NAME} characters"
                raise self._fault_in(column, code, name, f"{_shown(text)} of {len(text)} characters", limit)
            if not text and not is_label:
                raise self._fault_in(column, code, name, "an empty cell", "a name")
            index.append(found.known.setdefault(text, len(found.known)))
        if column.null_count and not is_label:
            raise self._fault_in(column, len(index), name, "an empty cell", "a name")
        index.append(found.known.setdefault("", len(found.known)) if column.null_count else -1)
        found.parts.append(np.array(index, dtype=np.int64)[_codes(column)])

    def _fault_in(self, column: Any, code: int, name: str, received: str, accepted: str) -> DataError:
        """Create the error about the first row of a batch that holds a distinct text."""
        return self._file.fault_at(self.rows + _row_of(column, code), name, received, accepted)


def _codes(column: Any) -> IndexArray:
    """Return the index of each row into the distinct texts of a column. An empty cell has the index behind the last."""
    codes = column.indices.fill_null(len(column.dictionary)).to_numpy(zero_copy_only=False)
    return np.asarray(codes, dtype=np.int64)


def _row_of(column: Any, code: int) -> int:
    """Return the first row of a column of texts that holds a distinct one, or the row itself if each is stored."""
    return int(np.argmax(_codes(column) == code)) if pa.types.is_dictionary(column.type) else code


def _first(empty: npt.NDArray[np.bool_], offset: int) -> int | None:
    return offset + int(empty.argmax()) if empty.any() else None


def _mask(column: Any) -> npt.NDArray[np.bool_]:
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.bool_)


def _is_number(text: str) -> bool:
    try:
        pa.scalar(text.strip()).cast(pa.float64())
    except pa.ArrowException:
        return False
    return True


def _shown(cell: object) -> str:
    """Return a cell for a message, cut if it is long."""
    text = repr(cell[: _SHOWN + 1]) if isinstance(cell, str) else str(cell)
    return text if len(text) <= _SHOWN + 2 else f"{text[:_SHOWN]}..."


def _accepted(name: str) -> str:
    return next((text for suffix, text in _UNITS.items() if name.endswith(suffix)), "a number")


def groups_of(names: Sequence[str], reserved: Collection[str], suffixes: Sequence[str]) -> Iterator[str]:
    """Yield the prefixes under which every suffix is a column, such as NAME of NAME_x_m, NAME_y_m, NAME_yaw_rad."""
    for name in names:
        prefix = name.removesuffix(suffixes[0])
        if (
            prefix
            and prefix != name
            and prefix not in reserved
            and all(prefix + suffix in names for suffix in suffixes)
        ):
            yield prefix
