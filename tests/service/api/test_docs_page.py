"""The page at /docs is whole without another host: its parts are served here, and a browser may load no others."""

import re
from base64 import b64encode
from hashlib import sha256
from html.parser import HTMLParser
from urllib.parse import urljoin

import pytest
from fastapi.testclient import TestClient

PROXY = "https://robots.example/cell-7/docs"
PARTS = {
    "swagger-ui-bundle.js": ("text/javascript", "application/javascript"),  # Python 3.11 knows the older name
    "swagger-ui.css": ("text/css",),
    "favicon.png": ("image/png",),
}


class Page(HTMLParser):
    """What a page refers to, and the scripts that stand in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.scripts: list[str] = []
        self._in_script = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Addresses stand in attributes."""
        self._in_script = tag == "script"
        self.addresses += [value for name, value in attrs if name in ("src", "href", "action", "data") and value]

    def handle_data(self, data: str) -> None:
        """What stands in a script is one."""
        if self._in_script:
            self.scripts.append(data)

    def handle_endtag(self, tag: str) -> None:
        """And ends with it."""
        self._in_script = False


@pytest.fixture
def page(client: TestClient) -> Page:
    """The page as a browser reads it."""
    response = client.get("/docs")
    assert response.headers["content-type"] == "text/html; charset=utf-8"
    assert "//" not in re.sub(r"<!--.*?-->", "", response.text)
    return Page(response.text)


def test_the_page_asks_for_its_own_parts_and_the_document_behind_any_prefix(page: Page) -> None:
    """Addresses are relative: a proxy may serve the service under a path of its own."""
    (document,) = re.findall(r"url: '(.*?)'", "".join(page.scripts))
    assert urljoin(PROXY, document) == "https://robots.example/cell-7/openapi.json"
    assert {urljoin(PROXY, address) for address in page.addresses} == {f"{PROXY}/{part}" for part in PARTS}


@pytest.mark.parametrize("part", PARTS)
def test_every_part_is_served_as_what_it_is_and_once(client: TestClient, part: str) -> None:
    """With its media type; a browser that has it is told that it is unchanged."""
    response = client.get(f"/docs/{part}")
    assert response.status_code == 200
    assert response.headers["content-type"].partition(";")[0] in PARTS[part]
    assert len(response.content) > 1000
    again = client.get(f"/docs/{part}", headers={"If-None-Match": response.headers["etag"]})
    assert (again.status_code, again.content, again.headers["cache-control"]) == (304, b"", "no-cache")


def test_the_style_asks_for_nothing_else(client: TestClient) -> None:
    """Every picture in it is within it."""
    style = client.get("/docs/swagger-ui.css").text
    assert "@import" not in style
    assert {address[:5] for address in re.findall(r"url\([\"']?([^\"')]*)", style)} == {"data:"}


def test_a_browser_may_load_nothing_from_elsewhere(client: TestClient, page: Page) -> None:
    """The policy names no host; of the scripts in the page those that are there may run, and no other."""
    policy = dict(
        part.strip().split(" ", 1) for part in client.get("/docs").headers["content-security-policy"].split(";")
    )
    assert policy["default-src"] == "'none'"
    digests = {f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" for script in page.scripts}
    assert len(digests) == 1
    assert set(policy["script-src"].split()) == {"'self'"} | digests
    sources = {source for sources in policy.values() for source in sources.split()}
    assert sources == {"'none'", "'self'", "'unsafe-inline'", "data:"} | digests
    assert [name for name, sources in policy.items() if "'unsafe-inline'" in sources] == ["style-src"]


@pytest.mark.parametrize("path", ["/redoc", "/docs/other.js", "/docs/", "/docs/..%2f__init__.py", "/docs/%2e%2e"])
def test_nothing_else_is_served_there(client: TestClient, path: str) -> None:
    """No second documentation, no file beside the parts."""
    response = client.get(path)
    assert (response.status_code, response.json()["code"]) == (404, "no_such_route")
