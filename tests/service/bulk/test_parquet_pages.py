"""Headers of pages are read from the bytes of a file, and tell the truth where its metadata may lie."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from service.bulk.parquet_pages import Page, read_chunks, read_pages
from service.errors import DataError

CLAIM = 1 << 30


def number(value: int) -> bytes:
    """Encode a whole number: zigzag, then seven bits a byte."""
    rest, found = (value << 1) ^ (value >> 63), bytearray()
    while rest > 0x7F:
        found.append(rest & 0x7F | 0x80)
        rest >>= 7
    return bytes([*found, rest])


def header(size: int, compressed: int, values: int) -> bytes:
    """Encode the header of a data page: type, sizes, and a struct with the values, a binary, a list and a truth."""
    inner = b"\x15" + number(values) + b"\x18\x03abc" + b"\x19\x25" + number(7) + number(8) + b"\x11\x00"
    return b"\x15\x00" + b"\x15" + number(size) + b"\x15" + number(compressed) + b"\x2c" + inner + b"\x00"


def written(folder: Path, content: bytes) -> Path:
    """Write a file."""
    path = folder / "pages"
    path.write_bytes(content)
    return path


def test_a_header_tells_what_a_page_becomes(tmp_path: Path) -> None:
    """Pages are found one after the other, whatever other fields their headers have."""
    first, second = header(CLAIM, 4, 9) + b"data", header(1, 0, 0)
    path = written(tmp_path, b"PAR1" + first + second + b"rest")
    assert [*read_pages(path, 4, len(first + second))] == [Page(CLAIM, 9), Page(1, 0)]


@pytest.mark.parametrize("compression", ["none", "snappy", "zstd", "gzip"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("dictionary", [True, False])
def test_pages_of_the_library_are_found(tmp_path: Path, compression: str, version: str, dictionary: bool) -> None:
    """For files of every kind the values of all data pages are the rows, and no page is larger than its column."""
    path = tmp_path / "table.parquet"
    table = pa.table({"x": np.arange(9000) % 50, "name": [f"name {number % 90}" for number in range(9000)]})
    pq.write_table(
        table, path, compression=compression, data_page_version=version, use_dictionary=dictionary, data_page_size=2000
    )
    for column in range(2):
        chunk = pq.read_metadata(path).row_group(0).column(column)
        start = chunk.dictionary_page_offset or chunk.data_page_offset
        pages = [*read_pages(path, start, chunk.total_compressed_size)]
        assert sum(page.values for page in pages[dictionary:]) == 9000
        assert sum(page.size for page in pages) <= chunk.total_uncompressed_size


FINE = header(9, 0, 1)


@pytest.mark.parametrize(
    "content",
    [
        FINE[:5],
        b"\x00",
        header(9, 1000, 1),
        header(-9, 0, 1),
        header(9, -40, 1),
        b"\x15" + b"\xff" * 50,
        b"\x1c" * 200,
        b"\x19\xf5\xff\xff\xff\x7f" + FINE,
        b"\x1b" + FINE,
    ],
    ids=["cut", "empty", "beyond", "negative", "backwards", "endless", "deep", "long list", "a map"],
)
def test_bytes_that_are_no_pages_are_refused(tmp_path: Path, content: bytes) -> None:
    """Damaged headers cost an error of the tree, and no other one and no endless loop."""
    path = written(tmp_path, content)
    with pytest.raises(DataError, match="pages: is damaged: its pages cannot be found"):
        list(read_pages(path, 0, len(content)))


def test_column_chunks_of_the_library_are_found(tmp_path: Path) -> None:
    """The footer tells the place and the size of every column of every group of rows, as the library does."""
    path = tmp_path / "table.parquet"
    table = pa.table({"x": np.arange(9000) % 50, "name": [f"name {number % 90}" for number in range(9000)]})
    pq.write_table(table, path, row_group_size=100, use_dictionary=["name"], write_page_index=True)

    metadata, found = pq.read_metadata(path), read_chunks(path)
    assert (len(found), {len(group) for group in found}) == (90, {2})
    for number, group in enumerate(found):
        for column, chunk in enumerate(group):
            known = metadata.row_group(number).column(column)
            assert chunk.size == known.total_compressed_size
            assert chunk.start == (known.dictionary_page_offset or known.data_page_offset)


@pytest.mark.parametrize(
    "content",
    [
        b"PAR1PAR1PAR1",
        b"PAR1" + b"\xff" * 40 + b"\x28\x00\x00\x00PAR1",
        b"PAR1....\x00\x00\x00\x7fPAR1",
        b"PAR1" * 9 + b"x",
    ],
    ids=["short", "damaged", "beyond", "cut"],
)
def test_a_file_without_a_footer_is_refused(tmp_path: Path, content: bytes) -> None:
    """A footer that is damaged, longer than the file or missing costs an error of the tree."""
    with pytest.raises(DataError, match="is damaged"):
        read_chunks(written(tmp_path, content))
