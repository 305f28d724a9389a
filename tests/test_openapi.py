"""OpenAPI document: the file in the repository is the app's own, and its schema accepts the contexts of the service."""

import base64
import itertools
import json
import re
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest

from service.app import create_app
from service.errors import InvalidRequestError
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.pushing.contexts import SHAPE_DIGITS, WEIGHT_LETTERS, ObjectContext
from service.registry.registry import Registry
from service.schemas.contexts import ContextBody
from service.settings import Settings


@pytest.fixture
def document() -> dict[str, Any]:
    """Return the OpenAPI document of the app, which needs no model."""
    app = create_app(Settings(), LoadedModels(Registry(Path("nowhere")), OnnxPredictor))
    return app.openapi()


def test_openapi_document_is_the_apps_own(
    document: dict[str, Any], project_root: Path, request: pytest.FixtureRequest
) -> None:
    """The file openapi/openapi.json is the document of the app. ``make openapi`` renews it."""
    path = project_root / "openapi" / "openapi.json"
    rendered = json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    if request.config.getoption("--renew-openapi"):
        path.write_text(rendered, encoding="utf-8")
    assert path.read_text(encoding="utf-8") == rendered, "run 'make openapi' and look at the difference"


def test_every_field_of_our_bodies_has_a_description_and_an_example(document: dict[str, Any]) -> None:
    """Every field of our bodies has a description, with its unit, and an example."""
    fields = {
        f"{name}.{field}": definition
        for name, schema in document["components"]["schemas"].items()
        for field, definition in schema.get("properties", {}).items()
    }
    assert len(fields) > 30
    assert [name for name, field in fields.items() if not field.get("description") and "$ref" not in field] == []
    assert [name for name, field in fields.items() if not field.get("examples") and "$ref" not in field] == []


def test_every_number_of_a_pose_has_its_unit(document: dict[str, Any]) -> None:
    """Every number of a pose has its unit, m or rad, in its description."""
    for body in ("PusherBody", "MeanBody", "StdBody"):
        for name, field in document["components"]["schemas"][body]["properties"].items():
            assert re.search(r"\bin rad\b" if name == "angle" else r"\bin m\b", field["description"]), (body, name)


def test_every_operation_is_described(document: dict[str, Any]) -> None:
    """Every operation has a summary and a description."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            assert operation.get("summary"), (method, path)
            assert operation.get("description"), (method, path)


def test_failures_are_described_as_problems(document: dict[str, Any]) -> None:
    """The document describes failures as problem+json, not in the framework's own form of an error."""
    assert "HTTPValidationError" not in document["components"]["schemas"]
    responses = document["paths"]["/v1/predict"]["post"]["responses"]
    for status in ("400", "404", "413", "415", "422", "503"):
        assert list(responses[status]["content"]) == ["application/problem+json"], status


INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator().astype(int).tolist()
VISUAL = base64.b64encode(bytes(1024)).decode()
ROWS = [[0.5] * 32] * 32
CONTEXTS: list[dict[str, Any]] = [
    *({"descriptor": f"1a{shape}{weight}3c4a"} for shape, weight in itertools.product(SHAPE_DIGITS, WEIGHT_LETTERS)),
    *(
        {"descriptor": text}
        for text in ("", "1a2b3c4", "1a2b3c4a1a", "1a2b3c4a\n", " 1a2b3c4a", "5a2b3c4a", "a1b2c3a4")
    ),
    *({"indicator": bits} for bits in (INDICATOR, INDICATOR[:35], [*INDICATOR, 0], [0] * 36, [1] * 36, [0.5] * 36)),
    *({"visual": text} for text in (VISUAL, VISUAL[:-1], VISUAL[4:], "AAAA" + VISUAL, "-" + VISUAL[1:], "")),
    *({"visual": rows} for rows in (ROWS, ROWS[:31], [*ROWS, [0.5] * 32], [[0.5] * 31] * 32, [[1.5] * 32] * 32, [])),
    {},
    {"descriptor": None},
    {"descriptor": "1a2b3c4a", "indicator": None},
    {"descriptor": "1a2b3c4a", "indicator": INDICATOR},
    {"indicator": INDICATOR, "visual": VISUAL},
]


@pytest.mark.parametrize("context", CONTEXTS, ids=lambda context: str(context)[:40])
def test_the_schema_accepts_the_contexts_of_the_service(document: dict[str, Any], context: dict[str, Any]) -> None:
    """The schema of a context is valid for the contexts that the service accepts, and for no others."""
    schema = {"$ref": "#/components/schemas/ContextBody", "components": document["components"]}
    try:
        ContextBody.model_validate(context).to_domain()
        taken = True
    except (ValueError, InvalidRequestError):
        taken = False
    assert jsonschema_rs.Draft202012Validator(schema).is_valid(context) is taken
