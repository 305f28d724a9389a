"""Manifests: both laws of the text, every format, and refusals that name the field."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from service.errors import BrokenModelError
from service.model.manifest import CARD_FILE, MODEL_FILE, Calibration, FileDigest, Manifest, Validity
from service.model.tensors import ContextKind
from tests.fakes import draft_manifest

DIGEST = FileDigest.of(b"content")
VALIDITY = Validity({"length_m": (0.005, 0.1)}, "every start")
SCALED = Calibration("conformal", 0.5, 0.9, 0.95, [0.001, 0.001, 0.01], 1.2, 0.5, 0.9, 0.95)


def whole(kind: ContextKind = ContextKind.INDICATOR) -> Manifest:
    """Return a manifest as it is published, with the digests of its files."""
    return replace(draft_manifest(kind=kind), files={MODEL_FILE: DIGEST, CARD_FILE: DIGEST})


@pytest.mark.parametrize("kind", ContextKind)
def test_a_manifest_survives_the_round_trip(kind: ContextKind) -> None:
    """Both laws hold: parsing the rendered text gives the manifest, and rendering that gives the text."""
    manifest = whole(kind)
    text = manifest.render()
    assert Manifest.parse(text) == manifest
    assert Manifest.parse(text).render() == text
    assert text.endswith(b"\n")
    assert list(json.loads(text)) == sorted(json.loads(text))


def test_a_manifest_of_format_1_is_read_for_ever(project_root: Path) -> None:
    """A published sample of format 1 is read, and rendered to the same bytes."""
    content = (project_root / "tests" / "data" / "manifest-format-1.json").read_bytes()
    assert Manifest.parse(content).render() == content


def test_manifests_of_format_2_are_read_for_ever(project_root: Path) -> None:
    """Versions that were published with format 2 are read, and rendered to the same bytes."""
    content = (project_root / "models" / "push-indicator" / "2" / "manifest.json").read_bytes()
    assert Manifest.parse(content).format == 2
    assert Manifest.parse(content).render() == content


def test_a_domain_and_joint_regions_survive_the_round_trip() -> None:
    """What came with format 3 is written if it is there, and left out if it is not."""
    manifest = replace(whole(ContextKind.SHAPE), validity=VALIDITY, calibration={"all": SCALED})
    assert Manifest.parse(manifest.render()) == manifest
    document = json.loads(manifest.render())
    assert document["validity"] == {"note": "every start", "ranges": {"length_m": [0.005, 0.1]}}
    assert document["calibration"]["all"]["scale"] == 1.2
    assert b"validity" not in whole().render()


def test_every_flipped_bit_of_a_manifest_is_refused() -> None:
    """No bit of the text can change: in spaces, digits, names or the digest itself."""
    content = whole().render()
    for place in range(len(content)):
        for bit in range(8):
            flipped = content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :]
            with pytest.raises(BrokenModelError, match=r"manifest\.json"):
                Manifest.parse(flipped)


def _changed(*path: str | int, to: Any, manifest: Manifest = whole()) -> bytes:  # noqa: B008 (frozen)
    """Return the text of a manifest with one field replaced, or removed with None."""
    document: Any = json.loads(manifest.render())
    parent = document
    for part in path[:-1]:
        parent = parent[part]
    if to is None:
        del parent[path[-1]]
    else:
        parent[path[-1]] = to
    return json.dumps(document).encode()


def test_values_of_a_recipe_keep_their_types() -> None:
    """A recipe reads texts, integers, fractions and booleans as they are: 1, 1.0 and true are three values."""
    recipe: dict[str, str | int | float | bool] = {"a": "1", "b": 1, "c": 1.0, "d": True}
    manifest = replace(whole(), recipe=recipe)
    found = Manifest.parse(manifest.render()).recipe
    assert [(name, type(value)) for name, value in found.items()] == [
        (name, type(value)) for name, value in recipe.items()
    ]
    assert found == recipe


def test_an_integer_is_a_number_where_a_fraction_is_expected() -> None:
    """JSON has one type of number, so 1 is read as 1.0 in a field of fractions."""
    content = _changed("metrics", "different-objects", "rmse", to=1, manifest=replace(whole(), format=1))
    found = Manifest.parse(content).metrics["different-objects"].rmse
    assert (found, type(found)) == (1.0, float)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a JSON document"),
        (b"\xff\xfe{}", "not a JSON document"),
        (b"[" * 100_000, "not a JSON document"),
        (b"[]", "format"),
        (_changed("format", to=4), "format"),
        (_changed("format", to=True), "format"),
        (_changed("validity", to={"ranges": {}}), "validity.note"),
        (_changed("validity", to={"ranges": {"length_m": [0.0]}, "note": "none"}), "validity.ranges.length_m"),
        (replace(whole(), format=2, validity=VALIDITY).render(), "format: 2 has no validity"),
        (replace(whole(), format=1, calibration={"all": SCALED}).render(), "format: 1 has no validity, rivals, scale"),
        (_changed("sha256", to="0" * 64), "sha256"),
        (_changed("sha256", to=None), "sha256"),
        (_changed("recipe", "epochs", to=2), "sha256"),
        (whole().render() + b" ", "sha256"),
        (whole().render().replace(b"fake pushes", b"\\ud800"), "not a JSON document"),
        (json.dumps(json.loads(whole().render()), indent=2).encode(), "sha256"),
        (_changed("sha256", to="0" * 64, manifest=replace(whole(), format=1)), "sha256"),
        (_changed("sha256", to="", manifest=replace(whole(), format=1)), "sha256"),
        (_changed("format", to=None), "sha256"),
        (_changed("version", to=0), "version"),
        (_changed("version", to=True), "version"),
        (_changed("version", to=1.0), "version"),
        (_changed("version", to=10**400), "version"),
        (_changed("name", to="../up"), "name"),
        (_changed("created", to=None), "created"),
        (_changed("surprise", to=1), "surprise"),
        (_changed("context_kind", to="smell"), "context_kind"),
        (_changed("inputs", 0, "shape", to=["n", 4.5]), "inputs"),
        (_changed("outputs", to={}), "outputs"),
        (_changed("files", "../model.onnx", to={"size": 1, "sha256": "0" * 64}), "files"),
        (_changed("files", MODEL_FILE, "sha256", to="0" * 63), "files"),
        (_changed("files", MODEL_FILE, "size", to=-1), "files"),
        (_changed("files", CARD_FILE, to=None), "files"),
        (_changed("recipe", "epochs", to=[2]), "recipe.epochs: "),
        (_changed("recipe", "epochs", to=2**63), "too large"),
        (_changed("recipe", "epochs", to="\x1b[31m"), "recipe.epochs: a text of one line"),
        (_changed("recipe", "a\nb" * 40, to=[2]), r"recipe\.\(name\)"),
        (_changed("recipe", to={str(place): 0 for place in range(1001)}), "recipe"),
        (_changed("version", to=10**9), "version"),
        (_changed("method", to="FCN\u202egnp"), "method: a text of one line"),
        (_changed("created", to="today\n"), "created: a text of one line"),
        (_changed("data", "source", to="x" * 5000), "data.source"),
        (_changed("metrics", "\x07bell", to={"rmse": 1.0, "std": 1.0, "distance_mm": 1.0, "nll": 1.0}), "metrics"),
        (_changed("self_check", "pusher", to=[[0.0] * 3] * 257), "self_check.pusher"),
        (_changed("recipe", "epochs", to=float("inf")), "recipe.epochs"),
        (_changed("normalisation", "input_mean", to=[True, 0.0, 0.0]), "normalisation.input_mean.0"),
        (_changed("normalisation", "input_mean", to=[2.0**63, 0.0, 0.0]), "normalisation.input_mean.0"),
        (_changed("metrics", "different-objects", "rmse", to="low"), "metrics.different-objects.rmse"),
        (_changed("self_check", "tolerance", to=0.0), "tolerance"),
        (replace(whole(), format=1).render().replace(b'"name"', b'"name": "other", "name"', 1), "occurs twice"),
        (replace(whole(), format=1).render().replace(b'"seed": 0', b'"seed": 1e999'), "recipe.seed"),
        (whole().render().replace(b'"tolerance": 0.0001', b'"tolerance": NaN'), "tolerance"),
        (whole().render().replace(b'"tolerance": 0.0001', b'"tolerance": 1e999'), "tolerance"),
    ],
)
def test_an_invalid_manifest_is_refused_by_field(content: bytes, message: str) -> None:
    """A text that is not a manifest is refused with an error that names the field at fault."""
    with pytest.raises(BrokenModelError, match=message):
        Manifest.parse(content)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("self_check", "context"), [[None] * 100_000]),
        (("self_check", "context"), [[None]] * 100_000),
        (("recipe",), {str(number): [] for number in range(100_000)}),
        (("metrics",), {str(number): {} for number in range(100_000)}),
        (("files",), {str(number): 0 for number in range(100_000)}),
    ],
    ids=["row", "rows", "recipe", "metrics", "files"],
)
def test_a_manifest_full_of_faults_is_refused_by_its_first_faults(path: tuple[str, ...], value: Any) -> None:
    """A collection is read up to its first fault, so a manifest of many faults costs no more than one of a few."""
    with pytest.raises(BrokenModelError, match=rf"manifest\.json: {path[0]}") as caught:
        Manifest.parse(_changed(*path, to=value))
    assert isinstance(caught.value.__cause__, ValidationError)
    assert caught.value.__cause__.error_count() <= 5
