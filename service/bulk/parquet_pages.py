"""Pages of a Parquet file, by the headers before them: how much memory it takes to decode them.

A file of a few kilobytes can become gigabytes: pages are compressed, a value is stored once for many rows, and the
sizes in the metadata of a file may be lies. The reader allocates what the header of each page says and refuses the page
if its content is of another size, so these headers are the truth. The library does not show them. They are structs in
the compact protocol of Thrift, which has one rule for each type. The footer is read in the same way.
Sources: parquet.thrift of the Parquet format; the compact protocol of Apache Thrift.
"""

import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from service.errors import DataError

_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_UNCOMPRESSED, _COMPRESSED, _DATA_PAGE, _DICTIONARY_PAGE, _DATA_PAGE_2 = 2, 3, 5, 7, 8  # fields of a page header
_VALUES: Final = 1  # field of the header of each kind of page
_DEEPEST: Final = 8  # structs in structs. A page header has three.
_MAX_ITEMS: Final = 1000  # of a list in a page header, which has none today
_MAX_FOOTER_ITEMS: Final = 1 << 20  # of a list in a footer, such as that of the row groups
_MAGIC: Final = b"PAR1"
_ROW_GROUPS, _COLUMNS, _CHUNK, _CHUNK_SIZE, _DATA_OFFSET, _DICTIONARY_OFFSET = 4, 1, 3, 7, 9, 11  # fields of a footer


@dataclass(frozen=True)
class Page:
    """Page of a column: the bytes that it takes once it is decompressed, and its number of values."""

    size: int
    values: int


@dataclass(frozen=True)
class ColumnChunk:
    """Column of a row group: the place of its first page in the file, and the bytes of all its pages there."""

    start: int
    size: int


def read_chunks(path: Path) -> list[list[ColumnChunk]]:
    """Return the column chunks of every row group, in the order of the columns, by the footer of a file.

    The library has them too, and ends the process when it meets damaged statistics beside them.

    Raises:
        DataError: the footer cannot be read.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        try:
            size, magic = int.from_bytes(content[-8:-4], "little"), content[-4:]
            if magic != _MAGIC or size > len(content) - 12:
                raise ValueError("no footer")
            footer, _ = _Reader(content, len(content) - 8 - size, _MAX_FOOTER_ITEMS).struct()
            return [[_chunk(column[_CHUNK]) for column in group[_COLUMNS]] for group in footer.get(_ROW_GROUPS, ())]
        except (IndexError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise _damaged(path) from error


def _chunk(fields: dict[int, Any]) -> ColumnChunk:
    offsets = filter(None, (fields.get(_DICTIONARY_OFFSET), fields[_DATA_OFFSET]))
    return ColumnChunk(int(min(offsets, default=0)), int(fields[_CHUNK_SIZE]))


def read_pages(path: Path, start: int, size: int) -> Iterator[Page]:
    """Yield the pages of a column chunk that lies at these bytes of a file.

    Raises:
        DataError: the headers cannot be read, or the pages do not fill the chunk.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        at, end = start, start + size
        while at < end:
            try:
                fields, at = _Reader(content, at).struct()
                page = _page(fields)
                at += int(fields[_COMPRESSED])
            except (IndexError, KeyError, TypeError, ValueError, RecursionError) as error:
                raise _damaged(path) from error
            if page.size < 0 or page.values < 0 or int(fields[_COMPRESSED]) < 0 or at > end:
                raise _damaged(path)
            yield page


def _damaged(path: Path) -> DataError:
    return DataError(f"{path}: is damaged: its pages cannot be found")


def _page(fields: dict[int, Any]) -> Page:
    for kind in (_DATA_PAGE, _DATA_PAGE_2, _DICTIONARY_PAGE):
        if kind in fields:
            return Page(int(fields[_UNCOMPRESSED]), int(fields[kind][_VALUES]))
    return Page(int(fields[_UNCOMPRESSED]), 0)


class _Reader:
    """A reader of values in the compact protocol. It reads whole numbers, structs and lists, and skips all others."""

    def __init__(self, content: mmap.mmap, at: int, most_items: int = _MAX_ITEMS) -> None:
        self._content = content
        self._at = at
        self._most_items = most_items

    def struct(self, depth: int = 0) -> tuple[dict[int, Any], int]:
        """Return the fields of a struct by their numbers, and the place behind it."""
        if depth > _DEEPEST:
            raise ValueError("too deep")
        fields: dict[int, Any] = {}
        number = 0
        while (head := self._byte()) & 0x0F:
            number = number + (head >> 4) if head >> 4 else self._integer()
            fields[number] = self._value(head & 0x0F, depth)
        return fields, self._at

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (_TRUE, _FALSE):
            return None
        if kind in (_I16, _I32, _I64):
            return self._integer()
        if kind == _STRUCT:
            return self.struct(depth + 1)[0]
        if kind in (_LIST, _SET):
            head = self._byte()
            items = head >> 4 if head >> 4 < 15 else self._varint()
            if items > self._most_items:
                raise ValueError("too long")
            kind = _BYTE if head & 0x0F in (_TRUE, _FALSE) else head & 0x0F
            return [self._value(kind, depth + 1) for _ in range(items)]
        if kind not in (_BYTE, _DOUBLE, _BINARY):
            raise ValueError("no type of a page header")
        length = {_BYTE: 1, _DOUBLE: 8}.get(kind) or self._varint()
        self._at += length
        return None

    def _byte(self) -> int:
        self._at += 1
        return self._content[self._at - 1]

    def _varint(self) -> int:
        found = shift = 0
        while (byte := self._byte()) & 0x80:
            found |= (byte & 0x7F) << shift
            shift += 7
            if shift > 63:
                raise ValueError("too long a number")
        return found | byte << shift

    def _integer(self) -> int:
        found = self._varint()
        return (found >> 1) ^ -(found & 1)
