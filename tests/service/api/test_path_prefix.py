"""The service below the path of a proxy, which strips its prefix or passes it on."""

import re
from collections.abc import Iterator
from urllib.parse import urljoin

import pydantic
import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings

PREFIX = "/robots/cazsl"
PUSH = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}}


@pytest.fixture(params=["strips", "passes on"])
def through_proxy(request: pytest.FixtureRequest, served: tuple[Registry, LoadedModels]) -> Iterator[TestClient]:
    """Return a client of a proxy with a prefix, by the path that the service gets for a path of the browser."""
    app = create_app(Settings(root_path=f"{PREFIX}/", poll_interval_s=3600), served[1])
    strips = request.param == "strips"

    class Proxy(TestClient):
        """Client that asks as a browser does, through the proxy."""

        def request(self, method, url, **options):  # type: ignore[no-untyped-def]
            """Send a request to a path below the prefix."""
            path = str(url)
            assert path.startswith(f"{PREFIX}/"), "the proxy passes no other path on"
            return super().request(method, path.removeprefix(PREFIX) if strips else path, **options)

    with Proxy(app) as client:
        yield client


def test_the_page_loads_all_its_parts_behind_a_prefix(through_proxy: TestClient) -> None:
    """Every link of the page, the OpenAPI document included, leads to a part of the service below the prefix."""
    address = f"{PREFIX}/docs"
    page = through_proxy.get(address)
    assert page.status_code == 200
    links = re.findall(r"""(?:src|href)="([^"]+)"|url: '([^']+)'""", page.text)
    assert len(links) == 4
    for link in map("".join, links):
        assert through_proxy.get(urljoin(address, link)).status_code == 200, link


def test_the_document_s_server_answers_every_way(through_proxy: TestClient) -> None:
    """A request to the server of the OpenAPI document, as the page sends it, is answered."""
    (server,) = through_proxy.get(f"{PREFIX}/openapi.json").json()["servers"]
    assert server["url"] == PREFIX
    assert through_proxy.post(f"{server['url']}/v1/predict", json=PUSH).status_code == 200
    assert through_proxy.get(f"{server['url']}/v2/models/push-none").status_code == 200
    assert through_proxy.get(f"{server['url']}/readyz").status_code == 200
    assert through_proxy.get(f"{server['url']}/nowhere").status_code == 404


def test_metrics_have_the_route_without_the_prefix(through_proxy: TestClient) -> None:
    """The label of a route is its template, whatever the proxy passes on."""
    through_proxy.post(f"{PREFIX}/v1/predict", json=PUSH)
    text = through_proxy.get(f"{PREFIX}/metrics").text
    assert 'cazsl_requests_total{route="/v1/predict",status="200"} 1.0' in text


def test_keys_are_required_behind_a_prefix(
    served: tuple[Registry, LoadedModels], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The prefix opens no route that needs a key."""
    path = tmp_path_factory.mktemp("keys") / "keys"
    path.touch()
    app = create_app(Settings(root_path=PREFIX, keys=path, poll_interval_s=3600), served[1])
    with TestClient(app) as client:
        for tried in ("/v1/models", f"{PREFIX}/v1/models", f"{PREFIX}{PREFIX}/v1/models", f"{PREFIX}//v1/models"):
            assert client.get(tried).status_code in (401, 404), tried
        assert client.get(f"{PREFIX}/v1/models").status_code == 401


@pytest.mark.parametrize(
    "value", ["cazsl", "/v1", "/docs/x", "/a b", "/../etc", "//host", "/a//b", "https://host/a", "/%2e"]
)
def test_a_prefix_that_is_no_plain_path_is_refused(value: str) -> None:
    """A prefix that is no path, or that is the begin of a route, is refused with the accepted form."""
    with pytest.raises(pydantic.ValidationError, match="a path such as /cazsl"):
        Settings(root_path=value)
