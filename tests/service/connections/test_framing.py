"""Framing finds the ends of heads and of chunked bodies, however their bytes are cut."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.connections.framing import (
    MAX_FRAMING_BYTES,
    ChunkedBody,
    end_of_head,
    expects_100,
    head_without_upgrade,
    path_and_query,
    straddling,
)
from service.errors import MalformedRequestError

HEAD = b"GET / HTTP/1.1\r\nhost: a\r\n\r\n"
CHUNKS = b'5;a="b"\r\nhello\r\n00B\r\n12\r\n\r\n\r\n789\r\n0\r\nx: y\r\nz: 1\r\n\r\n'


def cut(data: bytes, cuts: list[int]) -> list[bytes]:
    """Cut bytes at these offsets."""
    edges = sorted(at % (len(data) + 1) for at in cuts)
    return [data[start:end] for start, end in zip([0, *edges], [*edges, len(data)], strict=True) if start < end]


@given(st.lists(st.integers(0, 1000), max_size=6), st.binary(max_size=9))
def test_the_end_of_a_head_is_found_in_any_pieces(cuts: list[int], behind: bytes) -> None:
    """The bytes behind a head are never read with it."""
    before, read = b"", 0
    for piece in cut(HEAD + behind, cuts):
        end = end_of_head(before, piece)
        if end >= 0:
            assert read + end == len(HEAD)
            return
        before, read = straddling(before, piece), read + len(piece)
    raise AssertionError("no end was found")


@given(st.lists(st.integers(0, 1000), max_size=6), st.binary(max_size=9))
def test_the_end_of_chunks_is_found_in_any_pieces(cuts: list[int], behind: bytes) -> None:
    """Content that looks like an end is none, and the trailers belong to the body."""
    body, read, passed = ChunkedBody(), 0, b""
    for piece in cut(CHUNKS + behind, cuts):
        chunks, end = body.walk(piece)
        passed += piece[:chunks]
        if end >= 0:
            assert read + end == len(CHUNKS)
            assert passed == CHUNKS.partition(b"x: y")[0]
            return
        read += len(piece)
    raise AssertionError("no end was found")


@pytest.mark.parametrize("size", [b"", b"g", b"-1", b"0x1", b"1 ", b" 1", b"1" * 17, b"1_0", b"1\n", b"\xd9\xa1"])
def test_a_size_is_hex(size: bytes) -> None:
    """A size that Python would read as a number, and HTTP would not, is refused."""
    with pytest.raises(MalformedRequestError, match="size"):
        ChunkedBody().walk(size + b"\r\n")


@pytest.mark.parametrize(
    "piece", [b"1\r\na\r\n", b"1;" + b"a" * 100 + b"\r\na\r\n", b"0\r\n" + b"a: b\r\n" * 9000, b"a" * 9000], ids=len
)
def test_framing_is_bounded_beside_the_content(piece: bytes) -> None:
    """Tiny chunks, extensions, trailers and a size without an end are refused before they cost more than content."""
    body = ChunkedBody()

    def walk() -> None:
        for _ in range(MAX_FRAMING_BYTES):
            body.walk(piece)

    with pytest.raises(MalformedRequestError):
        walk()


def test_large_chunks_are_not_bounded_by_their_number() -> None:
    """Content pays for its own framing."""
    body = ChunkedBody()
    for _ in range(MAX_FRAMING_BYTES):
        assert body.walk(b"10\r\n0123456789abcdef\r\n")[1] == -1


def test_a_head_loses_only_its_offer() -> None:
    """Other options of the connection stay."""
    headers = [(b"host", b"a"), (b"connection", b"Upgrade, close, HTTP2-Settings"), (b"upgrade", b"h2c")]
    head = head_without_upgrade(
        b"POST", b"/x", "1.1", [*headers, (b"http2-settings", b"AA"), (b"content-length", b"5")]
    )
    assert head == b"POST /x HTTP/1.1\r\nhost: a\r\nconnection: close\r\ncontent-length: 5\r\n\r\n"


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        (b"/a?b=c#d", (b"/a", b"b=c")),
        (b"http://a:8/x?y", (b"/x", b"y")),
        (b"http://a", (b"/", b"")),
        (b"*", (b"*", b"")),
        (b"a:443", None),
        (b"", None),
    ],
)
def test_a_target_has_a_path_and_a_query(target: bytes, expected: tuple[bytes, bytes] | None) -> None:
    """The host of a whole URL is left out, and its empty path is the root."""
    assert path_and_query(target) == expected


@pytest.mark.parametrize(("value", "expected"), [(b"100-Continue", True), (b"200-ok", False)])
def test_only_one_expectation_is_known(value: bytes, expected: bool) -> None:
    """Its case does not matter."""
    assert expects_100([(b"expect", value)]) is expected
