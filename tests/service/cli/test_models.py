"""Tests of the commands of ``cazsl models`` that read a registry."""

import json
import shutil
from pathlib import Path

from service.registry.registry import Registry
from service.validity.domains import RING
from tests.fakes import publish_fake
from tests.service.cli.command_line import NAME, document, force, run


def test_help_of_every_command_is_printed(root: Path) -> None:
    """The help of the group has examples and exit statuses, and every command prints a help."""
    text = run(root, "--help").output
    for word in ("promote", "rollback", "doctor", "Exit status: 0 done", "diff NAME@champion NAME@4"):
        assert word in text
    for line in text.partition("Commands:")[2].splitlines():
        if command := line.strip().partition(" ")[0]:
            assert run(root, command, "--help").exit_code == 0


def test_models_are_listed_shown_and_verified(project_root: Path) -> None:
    """The shipped models are listed with versions and aliases, shown by card or manifest, and pass every check."""
    shipped = project_root / "models"
    assert "push-indicator  versions 1" in run(shipped, "list").output
    assert "simulated" in run(shipped, "show", "push-indicator").output
    shown = run(shipped, "show", "push-indicator@1", "--json").output
    assert json.loads(shown)["method"] == "FCN + CM + L2Reg"
    assert run(shipped, "show", "push-indicator@2").output.endswith(f"this version vouches for {RING.note}.\n")
    assert run(shipped, "show", "push-indicator").output.count("## Domain") == 1, "its card has its domain"
    verified = run(shipped, "verify")
    assert (verified.exit_code, "push-indicator@1  ok" in verified.output) == (0, True)


def test_verify_names_the_changed_file(project_root: Path, tmp_path: Path) -> None:
    """A changed byte makes ``verify`` fail with exit status 1 and a line with the version and the file."""
    shutil.copytree(project_root / "models", tmp_path / "models")
    model = tmp_path / "models" / "push-indicator" / "1" / "model.onnx"
    content = bytearray(model.read_bytes())
    content[1000] ^= 1
    model.write_bytes(content)
    result = run(tmp_path / "models", "verify")
    assert result.exit_code == 1
    assert "push-indicator@1  BROKEN  model.onnx: the sha256 differs" in result.output


def test_verify_refuses_an_invalid_graph(tmp_path: Path) -> None:
    """A model file with the right digest that is not an ONNX model fails verification."""
    publish_fake(Registry(tmp_path / "models"))
    result = run(tmp_path / "models", "verify", "push-indicator")
    assert result.exit_code == 1
    assert "not an ONNX model" in result.output


def test_missing_registry_is_one_line(tmp_path: Path) -> None:
    """A missing registry is an error of one line with exit status 1."""
    result = run(tmp_path / "gone", "list")
    assert result.exit_code == 1
    assert "the registry cannot be listed" in result.output


def test_list_of_an_empty_registry_names_the_next_step(tmp_path: Path) -> None:
    """An empty registry is no error, and the output says how to train a model."""
    result = run(tmp_path, "list")
    assert (result.exit_code, "make train" in result.output) == (0, True)


def test_at_prints_the_version_of_an_alias_at_an_instant(project_root: Path) -> None:
    """A day counts to its end, and an instant before the first version has no version."""
    root = project_root / "models"
    assert run(root, "at", f"{NAME}@champion", "2026-11-22").output == f"{NAME}@1\n"
    assert document(root, "at", NAME, "2026-11-22T23:39:28+00:00")["version"] == 1
    assert run(root, "at", NAME, "2026-11-21").exit_code == 5
    assert run(root, "at", NAME, "yesterday").exit_code == 2


def test_diff_prints_differing_fields_side_by_side(root: Path, project_root: Path) -> None:
    """Differing fields are printed side by side, and equal ones only with --all."""
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


def test_history_tells_a_dropped_alias_from_one_that_is_set(root: Path) -> None:
    """The line of an alias that was dropped says that it names no version. The line of its setting does not."""
    registry = Registry(root)
    registry.point_alias(NAME, "canary", 1)
    registry.drop_alias(NAME, "canary")
    *_, was_set, dropped = run(root, "history", NAME).output.splitlines()
    assert was_set.endswith("alias canary 1")
    assert dropped.endswith("alias canary 1 -> none")


def test_tampered_history_has_exit_status_1(root: Path) -> None:
    """A changed line in a history is reported with its line number, and the exit status is 1."""
    force(root, 2)
    path = root / NAME / "history.jsonl"
    path.write_bytes(path.read_bytes().replace(b'"from": null, "to": 2', b'"from": null, "to": 3', 1))
    result = run(root, "history", NAME)
    assert result.exit_code == 1
    assert "the chain breaks at line" in result.output


def test_doctor_lists_faults_with_remedies(root: Path) -> None:
    """The doctor lists each fault with a remedy. The exit status is 1 if predictions suffer."""
    force(root, 1)
    (root / "notes.txt").write_text("x")
    (root / NAME / ".staging-1").mkdir()
    (root / NAME / "old").mkdir()
    found = document(root, "doctor")
    assert {finding["where"] for finding in found} == {
        f"{NAME}@champion",  # gates refuse it
        "notes.txt",
        f"{NAME}/.staging-1",
        f"{NAME}/old",
    }
    (root / NAME / "1" / "card.md").unlink()
    (root / NAME / "3").mkdir()
    (root / NAME / "aliases" / "canary").write_text("9\n")
    found = document(root, "doctor", status=1)
    advice = {finding["where"]: (finding["wrong"], finding["advice"]) for finding in found if finding["severe"]}
    assert "card.md: No such file" in advice[f"{NAME}/1"][0]
    assert "rollback" in advice[f"{NAME}/1"][1]
    assert "manifest.json: No such file" in advice[f"{NAME}/3"][0]
    assert f"cazsl models remove {NAME}@3" in advice[f"{NAME}/3"][1]
    assert "names version 9, which does not exist" in advice[f"{NAME}@canary"][0]


def test_errors_are_json_with_a_stable_code(root: Path) -> None:
    """An error with --json is one JSON document with a stable code, and results are JSON documents too."""
    assert document(root, "show", f"{NAME}@9", status=5)["code"] == "unknown_model"
    assert document(root, "list", "--registry", "ftp://x", status=1)["code"] == "registry"
    assert document(root, "doctor", "--registry", str(root / "gone"), status=1)["code"] == "registry"
    verified = document(root, "verify", status=3)[0]
    assert (verified["reference"], verified["ok"], verified["detail"]) == (f"{NAME}@1", True, None)
    assert document(root, "list") == [{"name": NAME, "versions": [1, 2], "aliases": {"champion": 1}}]


def test_texts_of_a_registry_bring_no_control_character_to_the_terminal(project_root: Path, tmp_path: Path) -> None:
    """A card, a file's and a folder's name with controls are printed as escapes by every command that reads."""
    hostile = "\x1b[2J\u202e\x9b31m"
    first = Registry(project_root / "models").read(NAME, 1)
    registry = Registry(tmp_path / "models")
    registry.publish(first.manifest, first.model, f"# {hostile}\nsecond line\n")
    registry.point_alias(NAME, "champion", 1)
    (tmp_path / "models" / f"a{hostile}\nb").mkdir()
    (tmp_path / "models" / NAME / f"c{hostile}").touch()
    for words in (["list"], ["show", NAME], ["diff", NAME, NAME], ["history", NAME], ["doctor"], ["verify"]):
        result = run(tmp_path / "models", *words)
        assert all(line.isprintable() for line in result.output.split("\n")), words
    shown = run(tmp_path / "models", "show", NAME).stdout
    assert "\\x1b[2J\\u202e\\x9b31m\nsecond line" in shown
