"""``/docs``: the page that shows and tries every route. It asks no other host for a part of itself, and may not.

Its parts are those of Swagger UI, which the package fastapi-offline carries: a robot's cell need not reach a CDN.
"""

import re
from base64 import b64encode
from hashlib import sha256

from fastapi import APIRouter, Request, Response
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.staticfiles import StaticFiles


def documentation(title: str) -> APIRouter:
    """The page and its parts, with addresses that hold behind a proxy's prefix too."""
    router = APIRouter(include_in_schema=False)
    parts = StaticFiles(packages=[("fastapi_offline", "static")])
    page = get_swagger_ui_html(
        openapi_url="openapi.json",
        title=title,
        swagger_js_url="docs/swagger-ui-bundle.js",
        swagger_css_url="docs/swagger-ui.css",
        swagger_favicon_url="docs/favicon.png",
        swagger_ui_parameters={"validatorUrl": None},  # a badge from Swagger's own host
    )
    page.headers["Content-Security-Policy"] = _policy(bytes(page.body).decode())

    @router.get("/docs")
    async def show() -> Response:
        """The page."""
        return page

    @router.get("/docs/{part}")
    async def show_part(part: str, request: Request) -> Response:
        """A script, a style or a picture of it."""
        response = await parts.get_response(part, request.scope)
        response.headers["Cache-Control"] = "no-cache"  # asked for again after an update; unchanged, it is a 304
        return response

    return router


def _policy(page: str) -> str:
    """What a browser may load for the page: from here only, and of scripts within it those that are in it now."""
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digests = [f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" for script in scripts]
    return "; ".join(
        [
            "default-src 'none'",
            f"script-src 'self' {' '.join(digests)}",
            "style-src 'self' 'unsafe-inline'",  # the page writes styles into its elements
            "img-src 'self' data:",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        ]
    )
