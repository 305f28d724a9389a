"""CSV files as spreadsheets write them: the accepted form, and one line for every other."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.training.tables.tables import fault_of, write_folder
from training.tables.csv_file import BLOCK_BYTES
from training.tables.reading import read_table


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of pushes of a valid table."""
    return write_folder(tmp_path) / "pushes.csv"


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda text: text.encode("utf-8-sig"), id="byte order mark"),
        pytest.param(lambda text: text.replace("\n", "\r\n").encode(), id="lines of Windows"),
        pytest.param(lambda text: text.rstrip("\n").encode(), id="no last line end"),
        pytest.param(lambda text: text.replace("box", '"box"').encode(), id="quotes"),
    ],
)
def test_other_writers_of_the_same_table_are_read(path: Path, change: Callable[[str], bytes]) -> None:
    """Read the marks, line ends and quotes of other programs."""
    path.write_bytes(change(path.read_text()))
    assert read_table(path).count == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace(",", ";").replace(".", ",").encode(), "has semicolons between its columns"),
        (lambda text: text.replace(",", "\t").encode(), "has tabs between its columns"),
        (lambda text: text.encode("utf-16"), "is text in UTF-16, although it is named .csv"),
        (lambda text: text.encode("utf-16-le"), "has no header of column names"),
        (lambda text: text.replace("\nbox", "\nb\u00f6x").encode("latin-1"), "line 2 is not text in UTF-8"),
        (lambda text: text.replace("object,", "objekt\u00f6,").encode("latin-1"), "line 1 is not text in UTF-8"),
        (lambda text: b"PK\x03\x04" + text.encode(), "is a workbook or an archive, although it is named .csv"),
        (lambda text: b"\n\n" + text.encode(), "has an empty first line"),
        (lambda text: text.replace("-0.06", "-0,06").encode(), "line 2 has 9 cells, but the header has 8 columns"),
        (lambda text: text.encode() + b"box,1,\xff\n", "line 3 has 3 cells, but the header has 8 columns"),
        (lambda text: (text + '"box,1\n').encode(), "line 3 has 1 cell, but the header has 8 columns"),
        (lambda text: text.encode() + b"box," + b"1" * (2 * BLOCK_BYTES), "has a row of more than 4 MiB"),
    ],
)
def test_a_file_of_another_form_is_refused_by_name(path: Path, change: Callable[[str], bytes], words: str) -> None:
    """Name the form of a file that is no CSV in UTF-8 with commas, instead of guessing its numbers."""
    path.write_bytes(change(path.read_text()))
    assert fault_of(path).startswith(words)


def test_a_fault_far_down_is_named_by_its_own_line(path: Path) -> None:
    """Count lines over the blocks in which a file is read."""
    header, push = path.read_text().splitlines()
    many = 2 * BLOCK_BYTES // len(push)
    path.write_text("\n".join([header, *[push] * many, push.replace("-0.06", "x")]))
    assert fault_of(path).startswith(f"row {many + 1} (line {many + 2}), column pusher_x_m: received 'x'")
    path.write_text("\n".join([header, *[push] * many, "box,1"]))
    assert fault_of(path).startswith(f"line {many + 2} has 2 cells")
