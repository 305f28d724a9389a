"""Path prefix: the service below a path of a proxy, such as ``https://host/cazsl/v1/predict``.

Some proxies strip their prefix, and others pass it on. The ring accepts both, and every part inside sees the path
without it. The page /docs has relative links, and its requests go to the servers of the OpenAPI document.
"""

from typing import Any

from starlette.types import ASGIApp, Receive, Scope, Send


class PathPrefix:
    """ASGI ring that strips a prefix from the path of requests. A path without it passes unchanged."""

    def __init__(self, inside: ASGIApp, prefix: str) -> None:
        self._inside = inside
        self._prefix = prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request inside."""
        if scope["type"] == "http" and scope["path"].startswith(f"{self._prefix}/"):
            scope["path"] = scope["path"][len(self._prefix) :]
            raw = scope.get("raw_path") or b""
            scope["raw_path"] = raw.removeprefix(self._prefix.encode("ascii"))
        await self._inside(scope, receive, send)


def servers(prefix: str) -> list[dict[str, Any]] | None:
    """Return the servers of the OpenAPI document, or None without a prefix: the address of the document counts."""
    return [{"url": prefix, "description": "this service, behind its proxy"}] if prefix else None
