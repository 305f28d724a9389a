"""The examples of the OpenAPI document: each operation and answer has one, each is right, and each is what happens.

Those of errors are provoked in tests/test_refusals.py.
"""

import base64
import io
import json
from collections.abc import Iterator

import jsonschema_rs
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from PIL import Image

from service.api.v1.uploads import FORM_TYPE
from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.registry.registry import Registry
from service.schemas.contexts import IMAGE_EXAMPLE
from service.settings import Settings
from tests.documented_api import Json, document, examples_of
from tests.running_service import ROOT

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
    models = LoadedModels(Registry(ROOT / "models"), OnnxPredictor)
    models.refresh()
    with TestClient(create_app(Settings(poll_interval_s=3600), models)) as client:
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
