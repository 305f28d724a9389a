"""Model references and manifests."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import BrokenModelError, InvalidRequestError
from service.model.manifest import CARD_FILE, MODEL_FILE, FileDigest, Manifest
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from tests.fakes import draft_manifest

DIGEST = FileDigest.of(b"content")


def whole(kind: ContextKind = ContextKind.INDICATOR) -> Manifest:
    """A manifest as it stands on disk."""
    return replace(draft_manifest(kind=kind), files={MODEL_FILE: DIGEST, CARD_FILE: DIGEST})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("push-indicator", ModelReference("push-indicator", "champion", None)),
        ("push-indicator@canary", ModelReference("push-indicator", "canary", None)),
        ("push-indicator@10", ModelReference("push-indicator", None, 10)),
    ],
    ids=["name alone", "alias", "version"],
)
def test_a_reference_is_a_name_with_an_alias_or_a_version(text: str, expected: ModelReference) -> None:
    """A name alone means its champion."""
    assert ModelReference.parse(text) == expected
    assert ModelReference.parse(str(expected)) == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "@1",
        "name@",
        "name@0",
        "name@01",
        "name@1@2",
        "../x",
        "a/b",
        "Name",
        "name@-1",
        "n" * 65,
        "name@1.5",
        "a\nb",
    ],
)
def test_what_is_no_reference_is_refused_without_being_repeated(text: str) -> None:
    """Paths, capitals, zeros and line ends are no references."""
    with pytest.raises(InvalidRequestError) as caught:
        ModelReference.parse(text, "body.model")
    assert caught.value.faults[0].where == "body.model"
    assert caught.value.faults[0].received == f"a text of {len(text)} characters"


@given(st.text(max_size=40))
def test_parsing_any_text_as_a_reference_ends_in_a_reference_or_our_error(text: str) -> None:
    """No text does anything else."""
    try:
        reference = ModelReference.parse(text)
    except InvalidRequestError:
        return
    assert ModelReference.parse(str(reference)) == reference


@pytest.mark.parametrize("kind", ContextKind)
def test_a_manifest_survives_the_round_trip(kind: ContextKind) -> None:
    """Both laws: parse of render is the manifest, render of parse is the text."""
    manifest = whole(kind)
    text = manifest.render()
    assert Manifest.parse(text) == manifest
    assert Manifest.parse(text).render() == text
    assert text.endswith(b"\n")
    assert list(json.loads(text)) == sorted(json.loads(text))


def test_a_manifest_of_format_1_is_read_for_ever(project_root: Path) -> None:
    """A sample of the format stays in the tests: what was published once can always be read."""
    content = (project_root / "tests" / "data" / "manifest-format-1.json").read_bytes()
    assert Manifest.parse(content).render() == content


def test_every_flipped_bit_of_a_manifest_is_refused() -> None:
    """Spaces, digits, names, the digest itself: no bit of the text can change."""
    content = whole().render()
    for place in range(len(content)):
        for bit in range(8):
            flipped = content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :]
            with pytest.raises(BrokenModelError, match=r"manifest\.json"):
                Manifest.parse(flipped)


def _changed(*path: str | int, to: Any) -> bytes:
    document: Any = json.loads(whole().render())
    place = document
    for part in path[:-1]:
        place = place[part]
    if to is None:
        del place[path[-1]]
    else:
        place[path[-1]] = to
    return json.dumps(document).encode()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a JSON document"),
        (b"\xff\xfe{}", "not a JSON document"),
        (b"[" * 100_000, "not a JSON document"),
        (b"[]", "format"),
        (_changed("format", to=3), "format"),
        (_changed("format", to=True), "format"),
        (_changed("sha256", to="0" * 64), "sha256"),
        (_changed("sha256", to=None), "sha256"),
        (_changed("recipe", "epochs", to=2), "sha256"),
        (whole().render() + b" ", "sha256"),
        (whole().render().replace(b"fake pushes", b"\\ud800"), "sha256"),
        (json.dumps(json.loads(whole().render()), indent=2).encode(), "sha256"),
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
        (_changed("metrics", "different-objects", "rmse", to="low"), "metrics.different-objects.rmse"),
        (_changed("self_check", "tolerance", to=0.0), "tolerance"),
        (whole().render().replace(b'"tolerance": 0.0001', b'"tolerance": NaN'), "not a JSON document"),
        (whole().render().replace(b'"tolerance": 0.0001', b'"tolerance": 1e999'), "tolerance"),
    ],
)
def test_what_is_no_manifest_is_refused_by_field(content: bytes, message: str) -> None:
    """The error names the field at fault."""
    with pytest.raises(BrokenModelError, match=message):
        Manifest.parse(content)
