"""Files of a table: their names, their limits, and the error at one place of one of them.

A table is a folder with ``pushes.csv`` or ``pushes.parquet`` and ``objects.csv`` or ``objects.parquet``. The names
``outlines.*`` are read too. Files come from other people, so their kind and size are checked before they are opened.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from service.errors import DataError
from service.files import check_regular

FORMATS: Final = (".csv", ".parquet")
PUSHES: Final = "pushes"
OBJECTS: Final = ("objects", "outlines")
MAX_BYTES: Final = 2 << 30  # of one file
MAX_PUSHES: Final = 10_000_000
MAX_CORNERS: Final = 4_000_000  # rows of an objects file
SPLIT_UP: Final = "split it into several tables"
_HEADER_LINES: Final = 1


@dataclass(frozen=True)
class TableFile:
    """File of a table, the kind of its rows, and their maximum."""

    path: Path
    rows: str  # such as pushes
    max_rows: int

    @property
    def is_csv(self) -> bool:
        """Format of the file, by its name."""
        return self.path.suffix.lower() == FORMATS[0]

    def fault(self, text: str) -> DataError:
        """Create an error about the file."""
        return DataError(f"{self.path}: {text}")

    def fault_at(self, row: int, column: str, received: str, accepted: str) -> DataError:
        """Create an error about one cell. Rows count from 0 here and from 1 in the message."""
        line = f" (line {row + 1 + _HEADER_LINES})" if self.is_csv else ""
        return self.fault(f"row {row + 1}{line}, column {column}: received {received}; accepted is {accepted}")

    def too_many_rows(self, rows: str) -> DataError:
        """Create the error about a file with more rows than a table may have."""
        return self.fault(f"received {rows} rows; accepted are up to {self.max_rows} {self.rows}: {SPLIT_UP}")

    def check(self) -> None:
        """Check the kind and the size of the file before it is opened.

        Raises:
            DataError: the file is missing, is a folder, pipe or device, is empty or too large, or has another name.
        """
        if self.path.suffix.lower() not in FORMATS:
            raise self.fault("is neither .csv nor .parquet by its name; export it as one of them, or rename it")
        try:
            status = self.path.stat()
            check_regular(self.path, status.st_mode)
        except OSError as error:
            raise self.fault(f"cannot be read ({error.strerror}); name a CSV or Parquet file of {self.rows}") from error
        if status.st_size > MAX_BYTES:
            received = f"{status.st_size / (1 << 30):.1f} GiB"
            raise self.fault(f"received {received}; accepted are up to {MAX_BYTES >> 30} GiB in one file: {SPLIT_UP}")
        if not status.st_size:
            raise self.fault("is empty; expected a header and rows, so export it again")


@dataclass(frozen=True)
class Header:
    """Names of the columns of a file, and those among them whose cells are numbers or texts."""

    names: tuple[str, ...]
    plain: frozenset[str]


def is_table(path: Path) -> bool:
    """Return whether a path is a table, or meant as one, rather than a folder in Omnipush's format."""
    if not path.is_dir():
        return path.suffix.lower() in FORMATS
    if any((path / f"{PUSHES}{suffix}").exists() for suffix in FORMATS):
        return True
    names = list(path.iterdir())
    return bool(_tables_in(names)) and not any(each.suffix == ".npy" or each.is_dir() for each in names)


def find_files(path: Path, objects_file: Path | None = None) -> tuple[TableFile, TableFile]:
    """Find the files of pushes and of objects of a table.

    Args:
        path: the folder of the table, or its file of pushes.
        objects_file: the file of objects, if it does not lie beside the pushes under one of its names.

    Raises:
        DataError: a file is missing, or present in two formats.
    """
    if not path.exists():
        raise DataError(
            f"{path} does not exist; name a folder with {PUSHES}.csv and {OBJECTS[0]}.csv (see docs/data.md)"
        )
    folder = path if path.is_dir() else path.parent
    pushes = _only(folder, (PUSHES,), "pushes") if path.is_dir() else path
    objects = objects_file or _only(folder, OBJECTS, "outlines")
    return TableFile(pushes, "pushes", MAX_PUSHES), TableFile(objects, "corners", MAX_CORNERS)


def _only(folder: Path, stems: tuple[str, ...], content: str) -> Path:
    names = [f"{stem}{suffix}" for stem in stems for suffix in FORMATS]
    found = [name for name in names if (folder / name).exists()]
    if len(found) > 1:
        raise DataError(f"{folder} holds {' and '.join(found)}; keep one of them, so that it is clear which one counts")
    if not found:
        others = _tables_in(folder.iterdir())
        advice = f"; it holds {', '.join(others[:3])}: rename it, or name it itself" if others else ""
        raise DataError(
            f"{folder} holds no file of {content}; expected {' or '.join(names)}{advice} (see docs/data.md)"
        )
    return folder / found[0]


def _tables_in(names: Iterable[Path]) -> list[str]:
    """Return the names of CSV and Parquet files."""
    return sorted(each.name for each in names if each.suffix.lower() in FORMATS)
