"""Verification of a version: its manifest must declare the tensors of the domain."""

from dataclasses import replace

import pytest

from service.errors import BrokenModelError
from service.model.manifest import CARD_FILE, MODEL_FILE, FileDigest, Manifest
from service.model.tensors import Tensor
from service.pushing.gates import PUSHING
from service.registry.verification import parse_manifest
from tests.fakes import draft_manifest


def rendered(**changes: tuple[Tensor, ...]) -> bytes:
    """Render a complete manifest with these changes."""
    files = {file: FileDigest.of(b"") for file in (MODEL_FILE, CARD_FILE)}
    manifest: Manifest = replace(draft_manifest(), files=files, **changes)  # type: ignore[arg-type]
    return manifest.render()


def test_a_manifest_with_the_tensors_of_the_domain_is_accepted() -> None:
    """A push model of this context kind declares exactly the tensors of the domain."""
    assert parse_manifest(rendered(), PUSHING).name == "push-indicator"


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"inputs": (replace(draft_manifest().inputs[0], shape=("n", 4)), *draft_manifest().inputs[1:])}, "inputs"),
        ({"inputs": draft_manifest().inputs[:1]}, "inputs"),
        ({"outputs": ()}, "outputs"),
        ({"outputs": draft_manifest().outputs[::-1]}, "outputs"),
    ],
    ids=["another shape", "no context", "no outputs", "outputs in another order"],
)
def test_a_manifest_with_other_tensors_is_refused_by_field(changes: dict[str, tuple[Tensor, ...]], field: str) -> None:
    """A manifest of valid form that is not of a push model is refused with the name of the field."""
    with pytest.raises(BrokenModelError, match=f"{field}: not the tensors"):
        parse_manifest(rendered(**changes), PUSHING)
