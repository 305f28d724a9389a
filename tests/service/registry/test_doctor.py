"""Tests of the diagnosis of a registry: each fault has its place, its severity and its remedy."""

import shutil
from pathlib import Path

import pytest

from service.errors import BrokenModelError
from service.model.tensors import ContextKind
from service.registry.doctor import examine
from service.registry.promotion import promote
from service.registry.registry import Registry
from service.storage.base import RegistryFinding
from tests.fakes import load_fake, publish_fake

NAME = "push-none"


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """A registry with two versions, of which the first is the champion."""
    found = Registry(tmp_path / "models")
    publish_fake(found, NAME, ContextKind.NONE)
    publish_fake(found, NAME, ContextKind.NONE, alias=None)
    return found


def findings(registry: Registry) -> dict[str, RegistryFinding]:
    """Examine a registry and return the findings by their place."""
    return {finding.where: finding for finding in examine(registry, load_fake)}


def test_registry_without_faults_has_no_findings(registry: Registry) -> None:
    """A registry without faults has no findings."""
    assert findings(registry) == {}


def test_broken_champion_is_severe_and_needs_a_rollback(registry: Registry) -> None:
    """A broken version that an alias names is severe, and its remedy starts with the alias."""
    (registry.root / NAME / "1" / "card.md").unlink()
    found = findings(registry)[f"{NAME}/1"]
    assert found.severe
    assert found.wrong.startswith("card.md:")
    assert f"point champion elsewhere (cazsl models rollback {NAME})" in found.advice


def test_broken_version_without_alias_can_be_removed(registry: Registry) -> None:
    """A broken version without an alias is restored or removed."""
    (registry.root / NAME / "2" / "model.onnx").write_bytes(b"FINE")
    found = findings(registry)[f"{NAME}/2"]
    assert found.advice.endswith(f"or cazsl models remove {NAME}@2")


def test_alias_of_a_missing_version_is_severe(registry: Registry) -> None:
    """An alias that names a missing version is severe, and its remedy is a promotion."""
    (registry.root / NAME / "aliases" / "canary").write_text("9\n", encoding="utf-8")
    found = findings(registry)[f"{NAME}@canary"]
    assert (found.severe, found.wrong) == (True, "names version 9, which does not exist")
    assert f"cazsl models promote {NAME} VERSION --alias canary" in found.advice


def test_torn_line_is_no_severe_fault(registry: Registry) -> None:
    """A torn last line and the change that it recorded are repaired by the next change, so they are not severe."""
    path = registry.root / NAME / "history.jsonl"
    path.write_bytes(path.read_bytes()[:-20])
    found = [finding for finding in examine(registry, load_fake) if finding.where == f"{NAME}/history"]
    assert [(finding.severe, finding.advice) for finding in found] == [
        (False, "the next change cuts it off"),
        (False, "the next change records it"),
    ]


def test_a_history_that_was_emptied_is_severe(registry: Registry) -> None:
    """An interrupted writer leaves one change without a line. More of them show that lines were taken out."""
    (registry.root / NAME / "history.head").unlink()
    (registry.root / NAME / "history.jsonl").write_bytes(b"")
    found = [finding for finding in examine(registry, load_fake) if finding.where == f"{NAME}/history"]
    assert [finding.severe for finding in found] == [True, False, False, False]
    assert found[0].wrong.startswith("3 changes are missing, so lines were cut off")


def test_broken_chain_is_severe(registry: Registry) -> None:
    """A changed line of a history is severe, because the chain breaks after it."""
    path = registry.root / NAME / "history.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"to": 1', b'"to": 2', 1))
    found = [finding for finding in examine(registry, load_fake) if "chain breaks" in finding.wrong]
    assert [finding.severe for finding in found] == [True]


def test_model_without_versions_is_reported(registry: Registry) -> None:
    """A model folder without versions is reported, but is not severe."""
    shutil.rmtree(registry.root / NAME)
    (registry.root / "push-visual").mkdir()
    found = findings(registry)
    assert set(found) == {"push-visual"}
    assert not found["push-visual"].severe


@pytest.mark.parametrize("forced", [False, True])
def test_an_alias_of_a_version_that_gates_refuse_is_reported(registry: Registry, forced: bool) -> None:
    """A refused version is severe behind an alias, unless its promotion was forced. Without an alias it is no fault."""
    name = "push-indicator"  # the fake turns an object that no pusher touches
    publish_fake(registry, name, alias=None)
    assert findings(registry) == {}
    if forced:
        promote(registry, load_fake, name, 1, "champion", reason="a trial", force=True)
    else:
        registry.point_alias(name, "champion", 1)
    found = findings(registry)
    assert set(found) == {f"{name}@champion"}
    assert found[f"{name}@champion"].severe != forced
    assert "names version 1, which gates refuse: no-contact 0.991 > 0.5" in found[f"{name}@champion"].wrong
    assert f"cazsl models rollback {name} --alias champion" in found[f"{name}@champion"].advice


def test_a_version_without_the_signature_that_the_service_needs_is_severe(registry: Registry) -> None:
    """The signatures of a registry are those that its service needs, and the remedy is to sign."""

    class Refusing:
        """A check of signatures that no version passes."""

        def check(self, files: dict[str, bytes], signature: bytes | None) -> None:
            """See ``Signatures.check``."""
            raise BrokenModelError("signature: there is none, but one is required")

    found = findings(Registry(registry.root, Refusing()))
    assert {place for place, finding in found.items() if finding.severe} == {f"{NAME}/1", f"{NAME}/2"}
    assert f"sign it (cazsl models sign {NAME}@1 --key KEY)" in found[f"{NAME}/1"].advice
