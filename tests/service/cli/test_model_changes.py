"""Tests of the commands of ``cazsl models`` that change a registry."""

from pathlib import Path

import pytest

from service.registry.registry import Registry
from tests.service.cli.command_line import NAME, at_a_terminal, document, force, run


def test_promotion_is_refused_with_figures(root: Path) -> None:
    """A refused promotion has exit status 3, prints every gate with its figure, and keeps the alias."""
    result = run(root, "promote", NAME, "2")
    assert result.exit_code == 3
    assert "REFUSE  no-contact" in result.output
    assert "--force --reason" in result.output
    answer = document(root, "promote", NAME, "2", status=3)
    gates = {gate["gate"]: gate["passed"] for gate in answer["gates"]}
    assert gates == {"no-contact": False, "turned": True, "angle-at-pi": False, "nll": True, "coverage": True}
    assert Registry(root).aliases(NAME) == {"champion": 1}


def test_forced_promotion_needs_a_reason_that_the_history_keeps(root: Path) -> None:
    """A forced promotion needs a reason. The history keeps it with the refusing gates and their figures."""
    assert run(root, "promote", NAME, "2", "--force").exit_code == 2
    assert force(root, 2).exit_code == 0
    assert Registry(root).aliases(NAME) == {"champion": 2}
    last = document(root, "history", NAME)["events"][-1]
    assert (last["what"], last["from"], last["to"]) == ("alias champion", 1, 2)
    assert last["reason"].startswith("trial (forced past no-contact 1.04 > 0.121")


def test_promotion_from_an_unexpected_version_is_a_conflict(root: Path) -> None:
    """A promotion from another version than --expect names has exit status 4, and the alias stays."""
    assert force(root, 2, "--expect", "1").exit_code == 0
    assert force(root, 1, "--expect", "1").exit_code == 4
    assert Registry(root).aliases(NAME) == {"champion": 2}
    assert force(root, 1, "--alias", "canary", "--expect", "0").exit_code == 0


def test_rollback_returns_to_the_previous_version(root: Path) -> None:
    """A rollback points the alias at its previous version and records the reason. Without a previous one it fails."""
    assert run(root, "rollback", NAME).exit_code == 5
    force(root, 2)
    assert document(root, "rollback", NAME, "--yes", "--reason", "worse")["event"]["to"] == 1
    assert document(root, "history", NAME)["events"][-1]["reason"].startswith("rollback: worse (forced past no-contact")


def test_rollback_to_a_version_that_gates_refuse_needs_consent(root: Path) -> None:
    """A rollback runs the gates. Where they refuse, a script has exit status 3, and --yes goes back all the same."""
    force(root, 2)
    result = run(root, "rollback", NAME)
    assert result.exit_code == 3
    assert "REFUSE  no-contact" in result.output
    assert f"{NAME}@champion stays. To move it anyway: --yes" in result.output
    assert document(root, "rollback", NAME, status=3)["moved"] is False
    assert Registry(root).aliases(NAME) == {"champion": 2}
    assert run(root, "rollback", NAME, "--yes").exit_code == 0
    assert Registry(root).aliases(NAME) == {"champion": 1}


@pytest.mark.parametrize(
    ("command", "question"),
    [
        (("remove", f"{NAME}@2"), f"Remove {NAME}@2 (version, for good)?"),
        (("remove", f"{NAME}@canary"), f"Remove {NAME}@canary (alias)?"),
        (("prune", NAME, "--keep", "1"), f"Remove 1 versions of {NAME} for good (2)?"),
        (("rollback", NAME, "--alias", "canary"), "gates refuse version 1: no-contact 1.04 > 0.121"),
    ],
    ids=["a version", "an alias", "old versions", "a rollback"],
)
@pytest.mark.parametrize("answer", ["n\n", "y\n"], ids=["no", "yes"])
def test_a_terminal_is_asked_before_something_is_lost(
    root: Path, command: tuple[str, ...], question: str, answer: str
) -> None:
    """At a terminal, commands that lose something ask first. After "no" the registry is as it was."""
    registry = Registry(root)
    first = registry.read(NAME, 1)
    registry.publish(first.manifest, first.model, first.card)
    for version in (1, 3):
        registry.point_alias(NAME, "canary", version)
    before = registry.state(NAME)
    status, printed = at_a_terminal(root, answer, *command)
    assert question in printed
    assert (registry.state(NAME) == before) == (answer == "n\n")
    assert (status == 0) == (answer == "y\n"), printed


def test_a_terminal_is_not_asked_with_yes_or_without_need(root: Path) -> None:
    """--yes asks nothing, and neither does a rollback that passes the gates, or a dry run."""
    assert at_a_terminal(root, "", "prune", NAME, "--keep", "1", "--dry-run")[0] == 0
    assert at_a_terminal(root, "", "remove", f"{NAME}@2", "--yes")[0] == 0
    assert Registry(root).versions(NAME) == [1]


def test_remove_refuses_a_version_with_an_alias(root: Path) -> None:
    """Removing a version with an alias has exit status 4 and names the alias. Others are removed."""
    result = run(root, "remove", f"{NAME}@1")
    assert (result.exit_code, "named by champion" in result.output) == (4, True)
    assert "not used again" in run(root, "remove", f"{NAME}@2", "--reason", "trial").output
    assert run(root, "remove", f"{NAME}@2").exit_code == 5
    assert run(root, "remove", NAME).exit_code == 2
    force(root, 1, "--alias", "canary")
    assert run(root, "remove", f"{NAME}@canary").exit_code == 0
    assert Registry(root).aliases(NAME) == {"champion": 1}


def test_prune_keeps_the_newest_versions_and_those_with_an_alias(root: Path) -> None:
    """Pruning keeps the newest versions and those with an alias. With --dry-run it removes none."""
    registry = Registry(root)
    first = registry.read(NAME, 1)
    for _ in range(3):
        registry.publish(first.manifest, first.model, first.card)
    assert document(root, "prune", NAME, "--keep", "2", "--dry-run") == {"removed": [], "would_remove": [2, 3]}
    assert document(root, "prune", NAME, "--keep", "2") == {"removed": [2, 3], "would_remove": []}
    assert registry.versions(NAME) == [1, 4, 5]


def test_push_and_pull_copy_whole_versions(root: Path, tmp_path: Path) -> None:
    """Push and pull copy a version with its number and bytes, and move no alias."""
    other = tmp_path / "other"
    assert run(root, "push", NAME, str(other)).exit_code == 0
    assert run(other, "pull", f"{NAME}@2", str(root)).exit_code == 0
    assert run(other, "list").output == f"{NAME}  versions 1, 2  no alias\n"
    assert Registry(other).read(NAME, 2) == Registry(root).read(NAME, 2)
    assert run(other, "pull", f"{NAME}@7", str(root)).exit_code == 5
