"""CSV files of a table, read as batches of texts: UTF-8, commas between columns, points in numbers, a header first.

Other files that spreadsheets write are refused by name, because to guess a separator or an encoding changes numbers.
"""

import codecs
import csv
import re
from collections.abc import Iterator
from typing import IO, Final

import pyarrow as pa
import pyarrow.csv as pc

from service.errors import DataError
from training.tables.files import Header, TableFile

MAX_HEADER: Final = 1 << 16  # bytes
BLOCK_BYTES: Final = 4 << 20  # rows that are parsed at a time. No row may be longer.
_AS_CSV: Final = "export it as CSV in UTF-8, with commas between the columns"
_UNEVEN: Final = re.compile(r"Row #(\d+): Expected (\d+) columns, got (\d+): (.*)", re.DOTALL)
_FOREIGN: Final = (  # first bytes, and the kind of file that begins so
    (codecs.BOM_UTF32_LE, "text in UTF-32"),
    (codecs.BOM_UTF32_BE, "text in UTF-32"),
    (codecs.BOM_UTF16_LE, "text in UTF-16"),
    (codecs.BOM_UTF16_BE, "text in UTF-16"),
    (b"PAR1", "Parquet"),
    (b"PK", "a workbook or an archive"),
    (b"\x1f\x8b", "compressed with gzip"),
    (b"\xd0\xcf\x11\xe0", "a workbook of Excel"),
)


def csv_header(file: TableFile) -> Header:
    """Return the header of a CSV file, without white space around the names.

    Raises:
        DataError: the file is no such CSV file.
    """
    try:
        with file.path.open("rb") as opened:
            head = opened.read(MAX_HEADER)
    except OSError as error:
        raise file.fault(f"cannot be read ({error.strerror}); check its permissions") from error
    for mark, kind in _FOREIGN:
        if head.startswith(mark):
            raise file.fault(f"is {kind}, although it is named .csv; {_AS_CSV}")
    line = head.splitlines()[0] if head.splitlines() else b""
    if b"\0" in line or len(line) == MAX_HEADER:
        raise file.fault(f"has no header of column names within {MAX_HEADER >> 10} KiB; {_AS_CSV}")
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise file.fault(f"line 1 is not text in UTF-8; {_AS_CSV}") from error
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in text and "," not in text:
            raise file.fault(
                f"has {name} between its columns (then numbers may have decimal commas); "
                f"{_AS_CSV} and points in the numbers"
            )
    names = tuple(name.strip() for name in next(csv.reader([text]), []))
    return Header(names, frozenset(names))


def csv_batches(file: TableFile, names: tuple[str, ...], wanted: tuple[str, ...]) -> Iterator[pa.RecordBatch]:
    """Yield the rows of a CSV file as columns of texts, without trust in any number. An empty cell is null.

    Args:
        file: the file.
        names: its header.
        wanted: the columns to read.

    Raises:
        DataError: a row has another number of cells than the header, is too long, or is not UTF-8.
    """
    try:
        with file.path.open("rb") as opened:
            yield from _open(opened, names, wanted)
    except (OSError, pa.ArrowException) as error:
        raise _fault(file, error) from error


def _open(opened: IO[bytes], names: tuple[str, ...], wanted: tuple[str, ...]) -> pc.CSVStreamingReader:
    return pc.open_csv(
        opened,
        read_options=pc.ReadOptions(
            use_threads=False, block_size=BLOCK_BYTES, column_names=[str(n) for n in range(len(names))], skip_rows=1
        ),
        parse_options=pc.ParseOptions(ignore_empty_lines=False),
        convert_options=pc.ConvertOptions(
            include_columns=[str(names.index(name)) for name in wanted],
            column_types={str(number): pa.string() for number in range(len(names))},
            null_values=[""],
            strings_can_be_null=True,
        ),
    )


def _fault(file: TableFile, error: Exception) -> DataError:
    """Return the error about a file that the library refused."""
    uneven = _UNEVEN.search(str(error))
    if uneven:
        line, columns, cells, text = uneven.groups()
        hint = "it has a quote that is not closed" if text.count('"') % 2 else "a decimal comma makes two cells of one"
        return file.fault(
            f"line {line} has {cells} {'cell' if cells == '1' else 'cells'}, but the header has {columns} columns; "
            f"correct that line ({hint})"
        )
    reason = str(error).splitlines()[0]
    if "UTF8" in reason:
        return file.fault(f"line {_undecodable_line(file)} is not text in UTF-8; {_AS_CSV}")
    if "straddl" in reason:
        return file.fault(f"has a row of more than {BLOCK_BYTES >> 20} MiB; {_AS_CSV}")
    return file.fault(f"cannot be read as CSV ({reason}); {_AS_CSV}")


def _undecodable_line(file: TableFile) -> int:
    """Return the number of the first line that is not UTF-8. Lines are counted from 1."""
    number = 0
    with file.path.open("rb") as opened:
        while line := opened.readline(BLOCK_BYTES):
            number += 1
            try:
                line.decode()
            except UnicodeDecodeError:
                break
    return number
