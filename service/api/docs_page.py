"""Documentation page ``/docs``, which shows every route and sends requests to it. It loads files of this host only.

The files are those of Swagger UI, from the package fastapi-offline: the network of a robot may not reach a CDN.
"""

import re
from base64 import b64encode
from hashlib import sha256

from fastapi import APIRouter, Request, Response
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.staticfiles import StaticFiles


def docs_router(title: str) -> APIRouter:
    """Return the routes of the page and its files. Their addresses also work behind the prefix of a proxy."""
    router = APIRouter(include_in_schema=False)
    parts = StaticFiles(packages=[("fastapi_offline", "static")])
    page = get_swagger_ui_html(
        openapi_url="openapi.json",
        title=title,
        swagger_js_url="docs/swagger-ui-bundle.js",
        swagger_css_url="docs/swagger-ui.css",
        swagger_favicon_url="docs/favicon.png",
        swagger_ui_parameters={"validatorUrl": None},  # otherwise the page loads a badge from the host of Swagger
    )
    page.headers["Content-Security-Policy"] = _policy(bytes(page.body).decode())

    @router.get("/docs")
    async def show() -> Response:
        """Return the page."""
        return page

    @router.get("/docs/{part}")
    async def show_part(part: str, request: Request) -> Response:
        """Return a script, a style or an image of the page."""
        response = await parts.get_response(part, request.scope)
        response.headers["Cache-Control"] = (
            "no-cache"  # browsers ask again, and get a 304 unless an update changed the file
        )
        return response

    return router


def _policy(page: str) -> str:
    """Return the Content-Security-Policy: only files of this host, and only the inline scripts of the page."""
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digests = [f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" for script in scripts]
    return "; ".join(
        [
            "default-src 'none'",
            f"script-src 'self' {' '.join(digests)}",
            "style-src 'self' 'unsafe-inline'",  # the page sets styles of its elements
            "img-src 'self' data:",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        ]
    )
