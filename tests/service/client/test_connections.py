"""Tests of the address of a service, and of the process and event loop that connections belong to."""

import httpx2
import pytest

from service.client import Client, ClientSetupError, UnreachableError
from service.client.connections import Connections, parse_address

ADDRESSES = [
    "http://localhost:8000",
    "http://localhost:8000/",
    "https://robots.example/push/",
    "http://[::1]:8000",
    "http://127.0.0.1:65535",
    "HTTP://Robots.Example.",
    "http://robot:pass@127.0.0.1:8000",
    "http://b\u00fccher.example",
    "http://" + ".".join(["a" * 63] * 3),
]
OTHERS = [
    "",
    " http://localhost",
    "http://localhost\n",
    "localhost:8000",
    "//localhost",
    "http:localhost",
    "http:///path",
    "ftp://localhost",
    "unix:///run/cazsl",
    "http://a..b",
    "http://.example",
    "http://" + "a" * 64,
    "http://localhost:0",
    "http://localhost:65536",
    "http://localhost:" + "9" * 5000,
    "http://localhost:port",
    "http://user:secret@localhost:port",
    "http://localhost?key=secret",
    "http://localhost/#secret",
    "http://[::1",
    "http://\0",
    "http://\ud800.example",
]


@pytest.mark.parametrize("url", ADDRESSES)
def test_address_of_a_service_is_read(url: str) -> None:
    """An address with or without a path, in every form of a host, is one."""
    assert parse_address(url).host


@pytest.mark.parametrize("url", OTHERS)
def test_other_address_is_refused_without_its_text(url: str) -> None:
    """Another text is refused as the client's address, and not shown, because it may hold a password."""
    with pytest.raises(ClientSetupError, match=r"^url: received (no|another) address; accepted is") as raised:
        Client(url)
    assert "secret" not in str(raised.value)
    assert "999" not in str(raised.value)


def test_password_in_an_address_is_not_shown_and_excludes_a_key() -> None:
    """An error names the address without name and password. With a key, only one of both could be sent."""
    with Client("http://robot:secret@127.0.0.1:9/push") as client, pytest.raises(UnreachableError) as raised:
        client.list_models()
    assert str(raised.value).startswith("http://127.0.0.1:9/push cannot be reached")
    with pytest.raises(ClientSetupError, match="beside a key"):
        Client("http://robot:secret@127.0.0.1:9", key="abc")


def test_another_user_gets_connections_of_its_own() -> None:
    """A forked process or a later event loop does not use the connections of the first. Given ones are kept."""
    users = ["first"]
    connections = Connections(None, httpx2.Client, lambda: users[-1])
    first = connections.in_use()
    assert connections.in_use() is first
    users.append("second")
    second = connections.in_use()
    assert second is not first
    assert connections.in_use() is second is connections.http
    given = httpx2.Client()
    kept = Connections(given, httpx2.Client, lambda: users[-1])
    assert kept.in_use() is given
    users.append("third")
    assert kept.in_use() is given
    for client in (first, second, given):
        client.close()
    with pytest.raises(UnreachableError, match="closed"):
        kept.in_use()
