"""The ``cazsl`` command on the shipped registry and on broken ones."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from service.cli.main import main
from service.registry.registry import Registry
from tests.fakes import publish_fake


def run(*arguments: str, registry: Path) -> Result:
    """Run the command as a person would."""
    return CliRunner().invoke(main, arguments, env={"CAZSL_REGISTRY": str(registry)})


@pytest.fixture
def shipped(project_root: Path) -> Path:
    """The registry of the project."""
    return project_root / "models"


def test_help_teaches(shipped: Path) -> None:
    """Every command is there, with examples of the common ones."""
    result = run("--help", registry=shipped)
    assert result.exit_code == 0
    for word in ("serve", "models", "predict 1a2b3c4a -- -0.075 0 0", "CAZSL_REGISTRY"):
        assert word in result.output


def test_predict_prints_what_the_service_would_answer(shipped: Path) -> None:
    """One push, no service."""
    result = run("predict", "1a2b3c4a", "--", "-0.075", "0", "0", registry=shipped)
    assert result.exit_code == 0, result.output
    answer = json.loads(result.output)
    assert answer["model"]["name"] == "push-indicator"
    assert 0.0 < answer["mean"]["x"] < 0.05


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["1a2b3c", "--", "0", "0", "0"], "8 characters"),
        (["1a2b3c4a", "--", "nan", "0", "0"], "x: Input should be"),
        (["1a2b3c4a", "--", "5", "0", "0"], "body.pusher.x: received 5 m"),
        (["1a2b3c4a", "--model", "nobody", "--", "0", "0", "0"], "there is no model nobody"),
        (["1a2b3c4a", "--model", "../x", "--", "0", "0", "0"], "accepted is name"),
    ],
    ids=["short descriptor", "not finite", "too far", "unknown model", "no reference"],
)
def test_a_push_that_cannot_be_predicted_is_one_line(shipped: Path, arguments: list[str], message: str) -> None:
    """Exit status 1, or 5 for what is not there, and no traceback."""
    result = run("predict", *arguments, registry=shipped)
    assert result.exit_code == (5 if "nobody" in arguments else 1)
    assert message in result.output
    assert "Traceback" not in result.output


def test_models_are_listed_shown_and_verified(shipped: Path) -> None:
    """Names, versions and aliases; the card or the manifest; every check."""
    assert "push-indicator  versions 1" in run("models", "list", registry=shipped).output
    assert "simulated" in run("models", "show", "push-indicator", registry=shipped).output
    shown = run("models", "show", "push-indicator@1", "--json", registry=shipped).output
    assert json.loads(shown)["method"] == "FCN + CM + L2Reg"
    verified = run("models", "verify", registry=shipped)
    assert (verified.exit_code, "push-indicator@1  ok" in verified.output) == (0, True)


def test_verification_fails_with_the_name_of_the_file(shipped: Path, tmp_path: Path) -> None:
    """One byte changed: exit status 1, the version and the file."""
    shutil.copytree(shipped, tmp_path / "models")
    model = tmp_path / "models" / "push-indicator" / "1" / "model.onnx"
    content = bytearray(model.read_bytes())
    content[1000] ^= 1
    model.write_bytes(content)
    result = run("models", "verify", registry=tmp_path / "models")
    assert result.exit_code == 1
    assert "push-indicator@1  BROKEN  model.onnx: the sha256 differs" in result.output


def test_a_graph_that_is_none_fails_verification(tmp_path: Path) -> None:
    """Digests alone make no model."""
    publish_fake(Registry(tmp_path / "models"))
    result = run("models", "verify", "push-indicator", registry=tmp_path / "models")
    assert result.exit_code == 1
    assert "not an ONNX model" in result.output


def test_a_missing_registry_is_told(tmp_path: Path) -> None:
    """One line that says what is wrong."""
    result = run("models", "list", registry=tmp_path / "gone")
    assert result.exit_code == 1
    assert "the registry cannot be listed" in result.output


def test_an_empty_registry_says_what_to_do_next(tmp_path: Path) -> None:
    """No model yet is no error."""
    result = run("models", "list", registry=tmp_path)
    assert (result.exit_code, "make train" in result.output) == (0, True)


def test_serving_with_an_impossible_setting_is_one_line(tmp_path: Path) -> None:
    """The line names the setting."""
    result = CliRunner().invoke(main, ["serve"], env={"CAZSL_PORT": "70000"})
    assert result.exit_code == 1
    assert result.output.startswith("Error: CAZSL_PORT")
