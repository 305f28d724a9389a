"""Callers: whom a request counts for. A caller is a verified key or an address, and never the text of a header.

The address is that of the connection. An IPv6 client has a network of its own (/64) rather than one address, so the
network counts as one caller.
"""

import ipaddress
from functools import lru_cache
from typing import Final

from starlette.types import Scope

from service.errors import CazslError, ForbiddenError, MissingKeyError
from service.transport.endpoints import header
from service.transport.keys import Keys
from service.transport.keys import Scope as KeyScope

_HEALTH: Final = "/v2/health/"
_NETWORK_BITS: Final = 64
LOCAL: Final = "address:127.0.0.1"  # the caller of ``Client.local``, which is this process


def needed_scope(path: str) -> KeyScope | None:
    """Return the scope of the keys that may ask for a path, or None if the path needs no key."""
    if path == "/metrics":
        return KeyScope.METRICS
    is_open = not path.startswith(("/v1/", "/v2")) or path.startswith(_HEALTH)
    return None if is_open else KeyScope.PREDICT


class Callers:
    """Callers of a service, which must have a key if the operator wants keys."""

    def __init__(self, keys: Keys) -> None:
        self._keys = keys

    def admit(self, scope: Scope) -> str:
        """Return the caller of a request by its head: ``key:NAME``, or ``address:IP`` if no key is needed.

        The answer is kept with the request, so that a key is checked once.

        Raises:
            MissingKeyError: the request has no key, or an unknown one.
            ForbiddenError: its key lacks the scope of the path.
        """
        state = scope.setdefault("state", {})
        known: str | CazslError | None = state.get("caller")
        if known is None:
            known = state["caller"] = self._caller(scope)
        if isinstance(known, CazslError):
            raise known
        return known

    def _caller(self, scope: Scope) -> str | CazslError:
        needed = needed_scope(scope["path"]) if self._keys.wanted else None
        if needed is not None:
            try:
                grant = self._keys.admit(header(scope["headers"], b"authorization"), needed)
            except (MissingKeyError, ForbiddenError) as error:
                return error
            if grant is not None:
                return f"key:{grant.name}"
        client = scope.get("client")
        return caller_at(client[0] if client else "")


def caller_of(scope: Scope) -> str:
    """Return the caller of a request that was admitted."""
    return str(scope["state"]["caller"])


@lru_cache(maxsize=1024)
def caller_at(host: str) -> str:
    """Return the caller at an address. A connection that has none, such as a Unix socket, is of one caller."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return f"address:{host}"
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return f"address:{address.ipv4_mapped}"
        return f"address:{ipaddress.ip_network((int(address), _NETWORK_BITS), strict=False)}"
    return f"address:{address}"
