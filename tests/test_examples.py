"""Examples of the OpenAPI document: each operation and answer has valid ones, and the service answers as they show.

Examples of errors are provoked in tests/test_refusals.py.
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
from service.schemas.contexts import IMAGE_EXAMPLE
from service.settings import Settings
from tests.documented_api import Json, document, examples_of
from tests.running_service import shipped_models

OPERATIONS = [
    (method, path, operation)
    for path, operations in document()["paths"].items()
    for method, operation in operations.items()
]
IDS = [f"{method} {path}" for method, path, _ in OPERATIONS]


def media_of(operation: Json) -> Iterator[tuple[str, str, Json]]:
    """Yield every content of an operation: "request" or the status, the media type, and its schema with examples."""
    for kind, media in operation.get("requestBody", {}).get("content", {}).items():
        yield "request", kind, media
    for status, response in operation["responses"].items():
        for kind, media in response["content"].items():
            yield status, kind, media


def validator(schema: Json) -> jsonschema_rs.Draft202012Validator:
    """Create a validator of a schema that may refer to schemas of the document."""
    return jsonschema_rs.Draft202012Validator({**schema, "components": document()["components"]})


@pytest.mark.parametrize(("method", "path", "operation"), OPERATIONS, ids=IDS)
def test_every_request_and_every_answer_has_valid_examples(method: str, path: str, operation: Json) -> None:
    """Every parameter, request body, success and failure has examples, which are valid under its schema."""
    for parameter in operation.get("parameters", []):
        assert validator(parameter["schema"]).is_valid(parameter["example"]), parameter["name"]
    for where, kind, media in media_of(operation):
        assert examples_of(media), (where, kind)
        for name, example in examples_of(media).items():
            assert "externalValue" in example or validator(media["schema"]).is_valid(example["value"]), (where, name)


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """Return a client of the app over the shipped models."""
    models = shipped_models(tmp_path_factory.mktemp("models"))
    with TestClient(create_app(Settings(poll_interval_s=3600), models)) as client:
        yield client


def send(client: TestClient, method: str, path: str, kind: str, example: Json) -> Response:
    """Send the example of a request in its media type. In a form the name of a file stands for the file."""
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
def test_every_request_example_is_answered_as_the_example_of_its_answer(
    shipped: TestClient, method: str, path: str, operation: Json
) -> None:
    """The answer to every request example has status 200 and the fields and types of an example of the answer."""
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
    """Return the type of each field of an answer, and of each field of its model, mean and std."""
    found: dict[str, str] = {}
    for name, part in value.items():
        found[name] = type(part).__name__
        if isinstance(part, dict) and name in ("model", "mean", "std"):
            found |= {f"{name}.{inner}": kind for inner, kind in shape(part).items()}
    return found


def test_the_example_of_a_context_from_an_image_is_exact(shipped: TestClient) -> None:
    """The examples of contexts from images equal the answers to the example image, a thumbnail pixel by pixel."""
    answered = document()["paths"]["/v1/contexts"]["post"]["responses"]["200"]["content"]["application/json"]
    example, outline = (one["value"] for one in examples_of(answered).values())
    image = base64.b64decode(IMAGE_EXAMPLE)
    assert outline == shipped.post("/v1/contexts", files={"image": image}, data={"metres_per_pixel": "0.0005"}).json()
    answer = shipped.post("/v1/contexts", content=image, headers={"Content-Type": "image/png"}).json()
    pixels = [Image.open(io.BytesIO(base64.b64decode(one.pop("thumbnail_png")))).tobytes() for one in (example, answer)]
    assert pixels[0] == pixels[1]
    assert example == answer


def test_a_binary_answer_is_like_its_example(shipped: TestClient) -> None:
    """A binary answer has the outputs of its example in the JSON part in front of the tensors."""
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
