"""Heads of requests: repeated fields are joined or refused, and HTTP/1.1 has a host."""

from typing import Any

import pytest

from service.errors import MalformedRequestError
from service.transport.heads import checked_headers, declared_length, head_bytes, is_host

HOST = (b"host", b"a")


def scope(*headers: tuple[bytes, bytes], version: str = "1.1") -> dict[str, Any]:
    """Return the scope of a request."""
    return {"type": "http", "path": "/livez", "http_version": version, "headers": list(headers)}


def test_parts_of_a_list_are_joined_in_their_order() -> None:
    """A repeated field is one list (RFC 9110, section 5.3), and the others stay in their places."""
    given = scope((b"accept", b"a/b"), HOST, (b"accept", b"c/d"), (b"accept", b"*/*"))
    assert checked_headers(given) == [(b"accept", b"a/b, c/d, */*"), HOST]
    alone = scope(HOST, (b"accept", b"a/b"))
    assert checked_headers(alone) is alone["headers"]


@pytest.mark.parametrize("name", ["host", "authorization", "content-type", "content-length"])
@pytest.mark.parametrize("value", [b"one", b"another"])
def test_a_field_that_may_come_once_is_refused_twice(name: str, value: bytes) -> None:
    """Also if both are the same: a proxy in front may have read the other one. The value is not repeated."""
    with pytest.raises(MalformedRequestError) as raised:
        checked_headers(scope(HOST, (name.encode(), b"one"), (name.encode(), value)))
    assert "another" not in str(raised.value)
    assert name.title() in str(raised.value)


def test_a_host_is_wanted_since_1_1() -> None:
    """HTTP/1.0 has none."""
    assert checked_headers(scope(version="1.0")) == []
    with pytest.raises(MalformedRequestError, match="Host"):
        checked_headers(scope())


@pytest.mark.parametrize(("value", "length"), [(b"12", 12), (b"9" * 40, int("9" * 18)), (b"x", 0), (None, 0)])
def test_a_declared_length_is_a_number(value: bytes | None, length: int) -> None:
    """A length beyond every limit stays beyond every limit."""
    assert declared_length(scope(*([] if value is None else [(b"content-length", value)]))) == length


def test_a_head_has_about_the_bytes_of_its_parts() -> None:
    """Path, names, values and what is between them."""
    assert head_bytes(scope((b"host", b"abc"))) == len("/livez") + len("host: abc\r\n")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (b"localhost", True),
        (b"localhost:8000", True),
        (b"10.0.0.1:", True),
        (b"[::1]:8000", True),
        (b"my_service.default.svc", True),
        (b"", True),
        (b"a/b", False),
        (b"a b", False),
        (b"a:b", False),
        (b"user@a", False),
        (b"http://a", False),
        (b"::1", False),
        ("ü".encode(), False),
    ],
)
def test_a_host_is_a_name_or_an_address(value: bytes, expected: bool) -> None:
    """Another value is refused: a proxy may have chosen the service by it."""
    assert is_host(value) is expected
    if not expected:
        with pytest.raises(MalformedRequestError):
            checked_headers(scope((b"host", value)))
