"""``cazsl models`` as ops use it: texts for people, JSON and exit statuses for scripts."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from service.cli.main import main
from service.registry.registry import Registry

NAME = "push-indicator"


def run(registry: Path, *arguments: str) -> Result:
    """One command."""
    return CliRunner().invoke(main, ["models", *arguments], env={"CAZSL_REGISTRY": str(registry)})


def document(registry: Path, *arguments: str, status: int = 0) -> Any:
    """What a command says with --json."""
    result = run(registry, *arguments, "--json")
    assert result.exit_code == status, result.output
    return json.loads(result.stdout)


@pytest.fixture
def root(project_root: Path, tmp_path: Path) -> Path:
    """The first version that shipped, twice: versions 1, the champion, and 2; it does not pass the gates of physics."""
    first = Registry(project_root / "models").read(NAME, 1)
    registry = Registry(tmp_path / "models")
    for _ in range(2):
        registry.publish(first.manifest, first.model, first.card)
    registry.point_alias(NAME, "champion", 1)
    return tmp_path / "models"


def force(root: Path, version: int, *arguments: str) -> Result:
    """Promote past the gates that the shipped model does not pass."""
    return run(root, "promote", NAME, str(version), "--force", "--reason", "trial", *arguments)


def test_the_help_of_every_command_teaches(root: Path) -> None:
    """Examples, and what exit statuses mean."""
    text = run(root, "--help").output
    for word in ("promote", "rollback", "doctor", "Exit status: 0 done", "diff NAME@champion NAME@4"):
        assert word in text
    for line in text.partition("Commands:")[2].splitlines():
        if command := line.strip().partition(" ")[0]:
            assert run(root, command, "--help").exit_code == 0


def test_a_promotion_is_refused_with_figures(root: Path) -> None:
    """Exit status 3, every gate with its figure, and the alias stays."""
    result = run(root, "promote", NAME, "2")
    assert result.exit_code == 3
    assert "REFUSE  no-contact" in result.output
    assert "--force --reason" in result.output
    answer = document(root, "promote", NAME, "2", status=3)
    gates = {gate["gate"]: gate["passed"] for gate in answer["gates"]}
    assert gates == {"no-contact": False, "turned": True, "angle-at-pi": False, "nll": True, "coverage": True}
    assert Registry(root).aliases(NAME) == {"champion": 1}


def test_forcing_needs_a_reason_and_the_history_keeps_it(root: Path) -> None:
    """Which gates were passed over, with their figures."""
    assert run(root, "promote", NAME, "2", "--force").exit_code == 2
    assert force(root, 2).exit_code == 0
    assert Registry(root).aliases(NAME) == {"champion": 2}
    last = document(root, "history", NAME)["events"][-1]
    assert (last["what"], last["from"], last["to"]) == ("alias champion", 1, 2)
    assert last["reason"].startswith("trial (forced past no-contact 1.04 > 0.121")


def test_a_promotion_from_something_else_than_expected_is_a_conflict(root: Path) -> None:
    """Exit status 4, and the alias stays."""
    assert force(root, 2, "--expect", "1").exit_code == 0
    assert force(root, 1, "--expect", "1").exit_code == 4
    assert Registry(root).aliases(NAME) == {"champion": 2}
    assert force(root, 1, "--alias", "canary", "--expect", "0").exit_code == 0


def test_a_rollback_goes_back_to_what_was_named_before(root: Path) -> None:
    """And says so; without a before there is nothing to do."""
    assert run(root, "rollback", NAME).exit_code == 5
    force(root, 2)
    assert document(root, "rollback", NAME, "--reason", "worse")["event"]["to"] == 1
    assert document(root, "history", NAME)["events"][-1]["reason"] == "rollback: worse"


def test_a_version_in_use_is_not_removed_and_one_that_is_not_is(root: Path) -> None:
    """Exit status 4 names the alias."""
    result = run(root, "remove", f"{NAME}@1")
    assert (result.exit_code, "named by champion" in result.output) == (4, True)
    assert "not given again" in run(root, "remove", f"{NAME}@2", "--reason", "trial").output
    assert run(root, "remove", f"{NAME}@2").exit_code == 5
    assert run(root, "remove", NAME).exit_code == 2
    force(root, 1, "--alias", "canary")
    assert run(root, "remove", f"{NAME}@canary").exit_code == 0
    assert Registry(root).aliases(NAME) == {"champion": 1}


def test_pruning_keeps_the_newest_and_what_is_named(root: Path) -> None:
    """--dry-run only says what would go."""
    registry = Registry(root)
    first = registry.read(NAME, 1)
    for _ in range(3):
        registry.publish(first.manifest, first.model, first.card)
    assert document(root, "prune", NAME, "--keep", "2", "--dry-run") == {"removed": [], "would_remove": [2, 3]}
    assert document(root, "prune", NAME, "--keep", "2") == {"removed": [2, 3], "would_remove": []}
    assert registry.versions(NAME) == [1, 4, 5]


def test_what_served_then_can_be_asked(project_root: Path) -> None:
    """A day counts to its end; before the first version nothing did."""
    root = project_root / "models"
    assert run(root, "at", f"{NAME}@champion", "2026-11-22").output == f"{NAME}@1\n"
    assert document(root, "at", NAME, "2026-11-22T23:39:28+00:00")["version"] == 1
    assert run(root, "at", NAME, "2026-11-21").exit_code == 5
    assert run(root, "at", NAME, "yesterday").exit_code == 2


def test_a_difference_is_shown_side_by_side(root: Path, project_root: Path) -> None:
    """What is the same is left out unless asked for."""
    registry = Registry(root)
    first = registry.read(NAME, 1)
    manifest = first.manifest
    recipe = {**manifest.recipe, "seed": 7}
    registry.publish(type(manifest)(**{**vars(manifest), "recipe": recipe}), first.model, first.card)
    assert document(root, "diff", f"{NAME}@1", f"{NAME}@3") == [{"field": "recipe.seed", "first": 0, "second": 7}]
    assert "recipe.seed" in run(root, "diff", f"{NAME}@1", f"{NAME}@3").output
    assert run(root, "diff", f"{NAME}@1", f"{NAME}@2").output == "no difference\n"
    assert "metrics.different-objects.nll" in run(root, "diff", f"{NAME}@1", f"{NAME}@2", "--all").output
    assert run(root, "diff", f"{NAME}@1", f"{NAME}@9").exit_code == 5


def test_a_tampered_history_is_told_by_its_exit_status(root: Path) -> None:
    """The line and the reason."""
    force(root, 2)
    path = root / NAME / "history.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"from": null, "to": 2', b'"from": null, "to": 3', 1))
    result = run(root, "history", NAME)
    assert result.exit_code == 1
    assert "the chain breaks at line" in result.output


def test_the_doctor_says_what_is_wrong_and_what_to_do(root: Path) -> None:
    """A healthy registry is well; every ailment has its line, and exit status 1 where serving suffers."""
    assert run(root, "doctor").output == "all is well\n"
    (root / "notes.txt").write_text("x")
    (root / NAME / ".staging-1").mkdir()
    (root / NAME / "old").mkdir()
    found = document(root, "doctor")
    assert {finding["where"] for finding in found} == {"notes.txt", f"{NAME}/.staging-1", f"{NAME}/old"}
    (root / NAME / "1" / "card.md").unlink()
    (root / NAME / "3").mkdir()
    (root / NAME / "aliases" / "canary").write_text("9\n")
    found = document(root, "doctor", status=1)
    advice = {finding["where"]: (finding["wrong"], finding["advice"]) for finding in found if finding["severe"]}
    assert "card.md: No such file" in advice[f"{NAME}/1"][0]
    assert "rollback" in advice[f"{NAME}/1"][1]
    assert "manifest.json: No such file" in advice[f"{NAME}/3"][0]
    assert f"cazsl models remove {NAME}@3" in advice[f"{NAME}/3"][1]
    assert "names version 9, which is not there" in advice[f"{NAME}@canary"][0]


def test_versions_are_pushed_and_pulled_whole(root: Path, tmp_path: Path) -> None:
    """Number and bytes; no alias moves by itself."""
    other = tmp_path / "other"
    assert run(root, "push", NAME, str(other)).exit_code == 0
    assert run(other, "pull", f"{NAME}@2", str(root)).exit_code == 0
    assert run(other, "list").output == f"{NAME}  versions 1, 2  no alias\n"
    assert Registry(other).read(NAME, 2) == Registry(root).read(NAME, 2)
    assert run(other, "pull", f"{NAME}@7", str(root)).exit_code == 5


def test_errors_are_json_for_scripts(root: Path) -> None:
    """With a stable code."""
    assert document(root, "show", f"{NAME}@9", status=5)["code"] == "unknown_model"
    assert document(root, "list", "--registry", "ftp://x", status=1)["code"] == "registry"
    assert document(root, "doctor", "--registry", str(root / "gone"), status=1)["code"] == "registry"
    assert document(root, "verify")[0] == {"reference": f"{NAME}@1", "ok": True, "detail": None}
    assert document(root, "list") == [{"name": NAME, "versions": [1, 2], "aliases": {"champion": 1}}]
