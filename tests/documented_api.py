"""The documented API: the OpenAPI document of the app, its examples, and the table of errors in docs/api.md."""

import re
from functools import cache
from pathlib import Path
from typing import Any

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import NO_KEYS
from tests.running_service import ROOT

Json = dict[str, Any]


@cache
def document() -> Json:
    """Return the OpenAPI document of an app with API keys, which has every possible answer. No model is needed."""
    app = create_app(Settings(keys=NO_KEYS), LoadedModels(Registry(Path("nowhere")), OnnxPredictor))
    return app.openapi()


def examples_of(media: Json) -> dict[str, Json]:
    """Return the examples of a media type by name. References are resolved."""
    found = media.get("examples", {"": {"value": media["example"]}} if "example" in media else {})
    known = document()["components"]["examples"]
    return {name: known[one["$ref"].rpartition("/")[2]] if "$ref" in one else one for name, one in found.items()}


@cache
def listed_errors() -> set[tuple[int, str]]:
    """Read each pair of status and code from the table of errors in docs/api.md."""
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    return {
        (int(status), code)
        for status, codes in re.findall(r"^\| (\d{3}) \| (.*?) \|", page, re.MULTILINE)
        for code in re.findall(r"`(\w+)`", codes)
    }
