"""Connections of a client: the address of the service, proxies and certificates of the environment, and their user."""

from collections.abc import Callable
from typing import Any, Final, Generic, TypeVar
from urllib.request import proxy_bypass

import httpx2

from service.client.errors import ClientSetupError, UnreachableError

MAX_LABEL, MAX_PORT = 63, 65535  # of a host
UNREACHABLE: Final = (
    httpx2.RequestError,
    httpx2.InvalidURL,
    RuntimeError,  # of a client that is closed while a call begins, or of an event loop that has ended
    *(UnicodeError, OverflowError, ExceptionGroup),  # of a proxy whose name or port no socket takes
)

H = TypeVar("H", httpx2.Client, httpx2.AsyncClient)


class Connections(Generic[H]):
    """Connections of a client. A process or event loop that uses them after another one gets its own.

    A forked process must not write on its parent's sockets, and a connection of asyncio ends with its event loop.
    """

    def __init__(self, given: H | None, create: Callable[[], H], user: Callable[[], object]) -> None:
        self._create: Callable[[], H] = create
        self._is_given = given is not None
        self._http: H = create() if given is None else given
        self._find_user = user
        self._user: object = None

    @property
    def http(self) -> H:
        """Return the client of httpx with the connections, also to close it."""
        return self._http

    def in_use(self) -> H:
        """Return the client of httpx for a request.

        Raises:
            UnreachableError: the client is closed.
        """
        if self._http.is_closed:
            raise UnreachableError("the client is closed; create another one")
        user = self._find_user()
        if self._user not in (None, user) and not self._is_given:
            self._http = self._create()
        self._user = user
        return self._http


def parse_address(url: str) -> httpx2.URL:
    """Parse the address of a service.

    Raises:
        ClientSetupError: it is not one.
    """
    accepted = "accepted is http://host:port or https://host:port, with a path if the service has one"
    try:
        address = httpx2.URL(url)
    except httpx2.InvalidURL as error:
        raise ClientSetupError(f"url: received no address; {accepted}") from error  # a cause may have a password
    host = address.host.removesuffix(".")
    labels = [host] if ":" in host else host.split(".")
    if (
        address.scheme not in ("http", "https")
        or not all(0 < len(label) <= MAX_LABEL for label in labels)
        or not (address.port is None or 0 < address.port <= MAX_PORT)
        or address.query
        or address.fragment
    ):
        raise ClientSetupError(f"url: received another address; {accepted}")
    return address


def connect_from_environment(url: str, client: Callable[..., H], transport: Callable[[], Any]) -> H:
    """Create the connections of a client from the settings of the environment for proxies and certificates.

    Args:
        url: address of the service. If ``no_proxy`` exempts it, the proxies of the environment are not read.
        client: class of the client of httpx.
        transport: class of its direct connections.

    Raises:
        ClientSetupError: a proxy or a certificate of the environment cannot be used.
    """
    try:
        address = httpx2.URL(url)
        port = address.port or (443 if address.scheme == "https" else 80)  # no_proxy may name it
        if proxy_bypass(f"{address.netloc.decode('ascii').removesuffix(f':{port}')}:{port}"):
            return client(transport=transport())
        return client()
    except ImportError as error:
        raise ClientSetupError("a proxy of the environment needs the package 'socksio': pip install socksio") from error
    except (ValueError, httpx2.InvalidURL) as error:
        raise ClientSetupError(
            f"HTTP_PROXY, HTTPS_PROXY or ALL_PROXY: received no address of a proxy ({error}); "
            "accepted is http://host:port"
        ) from error
    except OSError as error:
        cause = error.strerror or str(error)
        raise ClientSetupError(
            f"SSL_CERT_FILE or SSL_CERT_DIR: received no readable certificates ({cause}); accepted are PEM files"
        ) from error
