"""The OpenAPI document in the repository is the app's own."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from service.app import create_app
from service.loaded_models import LoadedModels
from service.predictor import OnnxPredictor
from service.registry import Registry
from service.settings import Settings


@pytest.fixture
def document() -> dict[str, Any]:
    """What the app says of itself; no model is needed for it."""
    app = create_app(Settings(), LoadedModels(Registry(Path("nowhere")), OnnxPredictor))
    return app.openapi()


def test_openapi_document_is_the_apps_own(
    document: dict[str, Any], project_root: Path, request: pytest.FixtureRequest
) -> None:
    """openapi/openapi.json is what the app produces; 'make openapi' renews it."""
    path = project_root / "openapi" / "openapi.json"
    rendered = json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    if request.config.getoption("--renew-openapi"):
        path.write_text(rendered, encoding="utf-8")
    assert path.read_text(encoding="utf-8") == rendered, "run 'make openapi' and look at the difference"


def test_every_field_of_our_bodies_has_a_description_and_an_example(document: dict[str, Any]) -> None:
    """A client reads in the document what each field means, units included, and sees one."""
    fields = {
        f"{name}.{field}": definition
        for name, schema in document["components"]["schemas"].items()
        for field, definition in schema.get("properties", {}).items()
    }
    assert len(fields) > 30
    assert [name for name, field in fields.items() if not field.get("description") and "$ref" not in field] == []
    assert [name for name, field in fields.items() if not field.get("examples") and "$ref" not in field] == []


def test_every_number_of_a_pose_has_its_unit(document: dict[str, Any]) -> None:
    """Metres or radians, in the words of the field."""
    for body in ("PusherBody", "MeanBody", "StdBody"):
        for name, field in document["components"]["schemas"][body]["properties"].items():
            assert re.search(r"\bin rad\b" if name == "angle" else r"\bin m\b", field["description"]), (body, name)


def test_every_operation_is_described(document: dict[str, Any]) -> None:
    """Every route has a summary and a description."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            assert operation.get("summary"), (method, path)
            assert operation.get("description"), (method, path)


def test_failures_are_described_as_problems(document: dict[str, Any]) -> None:
    """The document promises problem+json, not the framework's own form of an error."""
    assert "HTTPValidationError" not in document["components"]["schemas"]
    responses = document["paths"]["/v1/predict"]["post"]["responses"]
    for status in ("400", "404", "413", "415", "422", "503"):
        assert list(responses[status]["content"]) == ["application/problem+json"], status
