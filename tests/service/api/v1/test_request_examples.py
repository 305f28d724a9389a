"""Examples of requests in the OpenAPI document are valid. tests/test_examples.py sends each of them."""

import base64
from typing import Any

import pytest

from service.api.v1.request_examples import IMAGE_UPLOAD, MANY_PUSHES, ONE_PUSH, PUSH_UPLOAD
from service.api.v1.uploads import FORM_TYPE, IMAGE_TYPES
from service.pushing.images import decode
from service.schemas.body import Body, validate_body
from service.schemas.pushes import BatchRequest, PredictRequest


@pytest.mark.parametrize(("examples", "kind"), [(ONE_PUSH, PredictRequest), (MANY_PUSHES, BatchRequest)])
def test_examples_in_json_are_valid(examples: dict[str, Any], kind: type[Body]) -> None:
    """Each example is a valid body of its route."""
    found = examples["requestBody"]["content"]["application/json"]["examples"]
    for example in found.values():
        validate_body(kind, example["value"])
    assert len(found) > 2


def test_forms_declare_their_fields() -> None:
    """A form requires its image, and has no other fields than those of its schema."""
    form = PUSH_UPLOAD["requestBody"]["content"][FORM_TYPE]  # type: ignore[index]
    properties = set(form["schema"]["properties"])
    assert form["schema"]["required"] == ["image"]
    for example in form["examples"].values():
        assert set(example["value"]) <= properties


@pytest.mark.parametrize("kind", IMAGE_TYPES)
def test_image_files_of_examples_can_be_decoded(kind: str) -> None:
    """Each accepted type of image has a file as an example."""
    content = IMAGE_UPLOAD["requestBody"]["content"][kind]  # type: ignore[index]
    prefix, _, data = content["examples"]["a file"]["externalValue"].partition(",")
    assert prefix == f"data:{kind};base64"
    decode(base64.b64decode(data))
