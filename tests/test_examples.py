"""The examples of the OpenAPI document: each operation and answer has one, each is right, and each is what happens."""

import base64
import io
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from PIL import Image

from service.app import create_app
from service.contract import ContextKind
from service.keys import Grant, Scope
from service.loaded_models import LoadedModels
from service.object_bodies import IMAGE_EXAMPLE
from service.predictor import OnnxPredictor
from service.registry import Registry
from service.settings import Settings
from service.uploads import FORM_TYPE
from tests.fakes import FAILING, load_fake, publish_fake
from tests.serving import ROOT

Json = dict[str, Any]
JSON = {"Content-Type": "application/json"}
PUSH = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}}


def make_client(models: LoadedModels, **settings: Any) -> TestClient:
    """The app over these models."""
    models.refresh()
    return TestClient(create_app(Settings(poll_interval_s=3600, **settings), models), raise_server_exceptions=False)


@cache
def document() -> Json:
    """What the app says of itself when it wants keys: every answer that there can be."""
    app = create_app(Settings(keys=Path("nowhere")), LoadedModels(Registry(Path("nowhere")), OnnxPredictor))
    return app.openapi()


OPERATIONS = [
    (method, path, operation)
    for path, operations in document()["paths"].items()
    for method, operation in operations.items()
]
IDS = [f"{method} {path}" for method, path, _ in OPERATIONS]


def media_of(operation: Json) -> Iterator[tuple[str, str, Json]]:
    """Everything that is sent or answered: where, as which media type, with which examples."""
    for kind, media in operation.get("requestBody", {}).get("content", {}).items():
        yield "request", kind, media
    for status, response in operation["responses"].items():
        for kind, media in response["content"].items():
            yield status, kind, media


def examples_of(media: Json) -> dict[str, Json]:
    """The examples of a media type by name, references followed."""
    found = media.get("examples", {"": {"value": media["example"]}} if "example" in media else {})
    known = document()["components"]["examples"]
    return {name: known[one["$ref"].rpartition("/")[2]] if "$ref" in one else one for name, one in found.items()}


def validator(schema: Json) -> jsonschema_rs.Draft202012Validator:
    """A validator of a schema that refers to those of the document."""
    return jsonschema_rs.Draft202012Validator({**schema, "components": document()["components"]})


@pytest.mark.parametrize(("method", "path", "operation"), OPERATIONS, ids=IDS)
def test_every_request_and_every_answer_has_an_example_that_is_right(method: str, path: str, operation: Json) -> None:
    """Parameters and bodies, successes and failures; each is what its own schema says."""
    for parameter in operation.get("parameters", []):
        assert validator(parameter["schema"]).is_valid(parameter["example"]), parameter["name"]
    for where, kind, media in media_of(operation):
        assert examples_of(media), (where, kind)
        for name, example in examples_of(media).items():
            assert "externalValue" in example or validator(media["schema"]).is_valid(example["value"]), (where, name)


@pytest.fixture(scope="module")
def shipped() -> Iterator[TestClient]:
    """The app over the models that ship."""
    with make_client(LoadedModels(Registry(ROOT / "models"), OnnxPredictor)) as client:
        yield client


def send(client: TestClient, method: str, path: str, kind: str, example: Json) -> Response:
    """A request example as its media type has it; the name of a file stands for the file."""
    if "externalValue" in example:
        content = base64.b64decode(example["externalValue"].partition(",")[2])
        return client.request(method, path, content=content, headers={"Content-Type": kind})
    if kind == FORM_TYPE:
        fields = dict(example["value"])
        image = base64.b64decode(IMAGE_EXAMPLE)
        texts = {name: value if isinstance(value, str) else json.dumps(value) for name, value in fields.items()}
        return client.request(method, path, files={"image": (texts.pop("image"), image)}, data=texts)
    return client.request(method, path, json=example["value"])


@pytest.mark.parametrize(("method", "path", "operation"), OPERATIONS, ids=IDS)
def test_every_request_example_is_answered_as_its_answer_shows(
    shipped: TestClient, method: str, path: str, operation: Json
) -> None:
    """With 200 and, field by field, what the example of the answer has."""
    for parameter in operation.get("parameters", []):
        path = path.replace(f"{{{parameter['name']}}}", str(parameter["example"]))
    content = operation.get("requestBody", {}).get("content", {})
    requests = [(kind, one) for kind, media in content.items() for one in examples_of(media).values()]
    assert requests or method == "get"
    answered = operation["responses"]["200"]["content"]["application/json"]
    for kind, example in requests or [("", {"value": None})]:
        response = send(shipped, method, path, kind, example) if kind else shipped.get(path)
        assert response.status_code == 200, response.text
        assert validator(answered["schema"]).is_valid(response.json())
        shapes = [shape(one["value"]) for one in examples_of(answered).values()]
        assert any(one.items() <= shape(response.json()).items() for one in shapes), response.text


def shape(value: Json) -> dict[str, str]:
    """The fields of an answer, and of the objects in it, with what kind of thing they hold."""
    found: dict[str, str] = {}
    for name, part in value.items():
        found[name] = type(part).__name__
        if isinstance(part, dict) and name in ("model", "mean", "std"):
            found |= {f"{name}.{inner}": kind for inner, kind in shape(part).items()}
    return found


def test_the_example_of_what_a_model_sees_is_what_it_sees(shipped: TestClient) -> None:
    """To the bit, and the thumbnail to the pixel, of the picture that is the example of an image."""
    answered = document()["paths"]["/v1/contexts"]["post"]["responses"]["200"]["content"]["application/json"]
    (example,) = (one["value"] for one in examples_of(answered).values())
    image = base64.b64decode(IMAGE_EXAMPLE)
    answer = shipped.post("/v1/contexts", content=image, headers={"Content-Type": "image/png"}).json()
    pixels = [Image.open(io.BytesIO(base64.b64decode(one.pop("thumbnail_png")))).tobytes() for one in (example, answer)]
    assert pixels[0] == pixels[1]
    assert example == answer


def test_raw_answers_are_what_their_example_shows(shipped: TestClient) -> None:
    """JSON of so many bytes as the header says, and the tensor behind it."""
    path = "/v2/models/push-indicator/infer"
    operation = document()["paths"]["/v2/models/{name}/infer"]["post"]
    (raw,) = examples_of(operation["responses"]["200"]["content"]["application/octet-stream"]).values()
    shown = base64.b64decode(raw["externalValue"].partition(",")[2])
    (first, *_) = examples_of(operation["requestBody"]["content"]["application/json"]).values()
    output = {"name": "mean", "parameters": {"binary_data": True}}
    answer = shipped.post(path, json=first["value"] | {"outputs": [output]})
    assert answer.headers["content-type"] == "application/octet-stream"
    heads = [json.loads(content[: content.index(b"]}") + 2]) for content in (shown, answer.content)]
    assert heads[0]["outputs"] == heads[1]["outputs"]


def encoded(content: bytes) -> Json:
    """A push of the object in an image."""
    return {**PUSH, "context": {"image": base64.b64encode(content).decode()}}


def wide_picture() -> bytes:
    """More pixels on a side than are taken."""
    buffer = io.BytesIO()
    Image.new("L", (9000, 1)).save(buffer, "PNG")
    return buffer.getvalue()


def serve_shipped(_: Path) -> TestClient:
    """The models that ship, and room for small bodies only."""
    return make_client(LoadedModels(Registry(ROOT / "models"), OnnxPredictor), max_body_bytes=4096)


def serve_nothing(folder: Path) -> TestClient:
    """No model."""
    return make_client(LoadedModels(Registry(folder / "empty"), load_fake))


def serve_failing(folder: Path) -> TestClient:
    """A model that fails on every push but its own check."""
    publish_fake(Registry(folder / "models"), "push-none", ContextKind.NONE, FAILING)
    return make_client(LoadedModels(Registry(folder / "models"), load_fake))


def serve_with_keys(folder: Path) -> TestClient:
    """A key that covers no prediction, sent with every request that sends none."""
    made, key = Grant.new("grafana", frozenset([Scope.METRICS]))
    (folder / "keys").write_text(made.line() + "\n")
    client = make_client(LoadedModels(Registry(ROOT / "models"), OnnxPredictor), keys=folder / "keys")
    client.headers["Authorization"] = f"Bearer {key}"
    return client


PREDICT, INFER = "/v1/predict", "/v2/models/push-indicator/infer"
PLAIN = {**PUSH, "context": {"descriptor": "1a2b3c4a"}}
PROVOKED: list[tuple[Any, str, str, str, Any, dict[str, str]]] = [
    # who serves, code, template, path, what is sent, headers
    (serve_shipped, "malformed_body", PREDICT, PREDICT, b"{", {}),
    (serve_shipped, "unknown_model", PREDICT, PREDICT, {**PLAIN, "model": "push-other"}, {}),
    (serve_shipped, "not_acceptable", PREDICT, PREDICT, PLAIN, {"Accept": "text/html"}),
    (serve_shipped, "body_too_large", PREDICT, PREDICT, b" " * 5000, {}),
    (serve_shipped, "image_too_large", PREDICT, PREDICT, encoded(wide_picture()), {}),
    (serve_shipped, "unsupported_media_type", PREDICT, PREDICT, PLAIN, {"Content-Encoding": "gzip"}),
    (serve_shipped, "unsupported_image", PREDICT, PREDICT, encoded(b"GIF89a"), {}),
    (serve_shipped, "invalid_image", PREDICT, PREDICT, encoded(base64.b64decode(IMAGE_EXAMPLE)[:60]), {}),
    (serve_shipped, "invalid_request", PREDICT, PREDICT, {**PUSH, "context": {"descriptor": "9a2b3c4a"}}, {}),
    (serve_shipped, "wrong_context_kind", PREDICT, PREDICT, {**PLAIN, "model": "push-visual"}, {}),
    (serve_shipped, "unknown_model", "/v1/models/{name}", "/v1/models/push-other", None, {}),
    (serve_shipped, "invalid_request", "/v1/models/{name}", "/v1/models/" + "a" * 65, None, {}),
    (serve_shipped, "not_acceptable", "/v1/models", "/v1/models", None, {"Accept": "text/html"}),
    (serve_shipped, "malformed_body", "/v2/models/{name}/infer", INFER, b"{", {}),
    (serve_shipped, "body_too_large", "/v2/models/{name}/infer", INFER, b" " * 5000, {}),
    (serve_shipped, "unsupported_media_type", "/v2/models/{name}/infer", INFER, b"{}", {"Content-Encoding": "br"}),
    (serve_shipped, "invalid_request", "/v2/models/{name}/infer", INFER, {"inputs": []}, {}),
    (serve_shipped, "unknown_model", "/v2/models/{name}", "/v2/models/push-other", None, {}),
    (serve_nothing, "model_not_ready", PREDICT, PREDICT, PLAIN, {}),
    (serve_nothing, "model_not_ready", "/v2/health/ready", "/v2/health/ready", None, {}),
    (serve_failing, "prediction", PREDICT, PREDICT, PUSH, {}),
    (serve_with_keys, "forbidden", PREDICT, PREDICT, PLAIN, {}),
    (serve_with_keys, "forbidden", "/v2", "/v2", None, {}),
    (serve_with_keys, "missing_key", PREDICT, PREDICT, PLAIN, {"Authorization": ""}),
    (serve_with_keys, "missing_key", "/v1/models", "/v1/models", None, {"Authorization": ""}),
]


@pytest.mark.parametrize(
    ("serve", "code", "template", "path", "sent", "headers"), PROVOKED, ids=[f"{one[1]} {one[2]}" for one in PROVOKED]
)
def test_an_error_that_is_provoked_is_what_its_example_shows(
    serve: Any, code: str, template: str, path: str, sent: Any, headers: dict[str, str], tmp_path: Path
) -> None:
    """Its status, its media type, its code and title, and the fields it has."""
    with serve(tmp_path) as client:
        content = sent if isinstance(sent, bytes | None) else json.dumps(sent).encode()
        response = client.request("GET" if sent is None else "POST", path, content=content, headers=JSON | headers)
    operation = document()["paths"][template]["get" if sent is None else "post"]
    (media,) = operation["responses"][str(response.status_code)]["content"].items()
    assert response.headers["content-type"] == media[0]
    example, answer = examples_of(media[1])[code]["value"], response.json()
    assert answer.keys() == example.keys()
    if not template.startswith("/v2"):
        told = ("type", "title", "status", "code")
        assert [answer[name] for name in told] == [example[name] for name in told]
        assert [one.keys() for one in answer["errors"]] == [one.keys() for one in example["errors"]]
