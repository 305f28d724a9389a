"""The page at /docs needs no other host: its parts are served here, and a browser may load no others."""

import re
from base64 import b64encode
from hashlib import sha256
from html.parser import HTMLParser
from urllib.parse import urljoin

import pytest
from fastapi.testclient import TestClient

PROXY = "https://robots.example/cell-7/docs"
PARTS = {
    "swagger-ui-bundle.js": ("text/javascript", "application/javascript"),  # Python 3.11 has the older name
    "swagger-ui.css": ("text/css",),
    "favicon.png": ("image/png",),
}


class Page(HTMLParser):
    """A page, by the addresses that it refers to and its inline scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.scripts: list[str] = []
        self._in_script = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep addresses in attributes, and note the start of a script."""
        self._in_script = tag == "script"
        self.addresses += [value for name, value in attrs if name in ("src", "href", "action", "data") and value]

    def handle_data(self, data: str) -> None:
        """Keep the text of a script."""
        if self._in_script:
            self.scripts.append(data)

    def handle_endtag(self, tag: str) -> None:
        """Note the end of a script."""
        self._in_script = False


@pytest.fixture
def page(client: TestClient) -> Page:
    """Return the page as a browser reads it."""
    response = client.get("/docs")
    assert response.headers["content-type"] == "text/html; charset=utf-8"
    assert "//" not in re.sub(r"<!--.*?-->", "", response.text)
    return Page(response.text)


def test_addresses_of_the_page_are_relative(page: Page) -> None:
    """The page finds its parts and the document also behind a proxy that serves it under a prefix."""
    (document,) = re.findall(r"url: '(.*?)'", "".join(page.scripts))
    assert urljoin(PROXY, document) == "https://robots.example/cell-7/openapi.json"
    assert {urljoin(PROXY, address) for address in page.addresses} == {f"{PROXY}/{part}" for part in PARTS}


@pytest.mark.parametrize("part", PARTS)
def test_every_part_has_its_media_type_and_is_cached(client: TestClient, part: str) -> None:
    """A part has its media type, and a browser that has it gets a 304."""
    response = client.get(f"/docs/{part}")
    assert response.status_code == 200
    assert response.headers["content-type"].partition(";")[0] in PARTS[part]
    assert len(response.content) > 1000
    again = client.get(f"/docs/{part}", headers={"If-None-Match": response.headers["etag"]})
    assert (again.status_code, again.content, again.headers["cache-control"]) == (304, b"", "no-cache")


def test_the_style_loads_no_other_file(client: TestClient) -> None:
    """Every picture of the style is within it."""
    style = client.get("/docs/swagger-ui.css").text
    assert "@import" not in style
    assert {address[:5] for address in re.findall(r"url\([\"']?([^\"')]*)", style)} == {"data:"}


def test_a_browser_may_load_files_of_this_host_only(client: TestClient, page: Page) -> None:
    """The policy names no other host, and allows only the inline scripts of the page."""
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
def test_no_other_file_is_served(client: TestClient, path: str) -> None:
    """There is no second documentation, and no file beside the parts."""
    response = client.get(path)
    assert (response.status_code, response.json()["code"]) == (404, "no_such_route")


def test_the_documentation_is_served(client: TestClient) -> None:
    """/docs is the page for people, and /openapi.json the document for programs."""
    assert client.get("/docs").status_code == 200
    assert client.get("/openapi.json").json()["info"]["title"] == "CAZSL"
