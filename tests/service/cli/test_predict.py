"""Tests of ``cazsl predict`` for one push. ``tests/service/bulk/test_predict_file.py`` tests files of pushes."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from service.cli.main import main


def predict(*arguments: str, registry: Path) -> Result:
    """Run ``cazsl predict`` with a registry."""
    return CliRunner().invoke(main, ["predict", *arguments], env={"CAZSL_REGISTRY": str(registry)})


def test_one_push_prints_the_answer_of_the_service(project_root: Path) -> None:
    """One push prints the JSON body that the service would answer, with the model that predicted."""
    result = predict("1a2b3c4a", "--", "-0.075", "0", "0", registry=project_root / "models")
    assert result.exit_code == 0, result.output
    answer = json.loads(result.output)
    assert answer["model"]["name"] == "push-indicator"
    assert 0.0 < answer["mean"]["x"] < 0.05


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["1a2b3c", "--", "0", "0", "0"], "8 characters"),
        (["1a2b3c4a", "--", "nan", "0", "0"], "x: Input should be"),
        (["1a2b3c4a", "--", "5", "0", "0"], "pusher.x: received 5 m"),
        (["1a2b3c4a", "--model", "absent", "--", "0", "0", "0"], "there is no model absent"),
        (["1a2b3c4a", "--model", "../x", "--", "0", "0", "0"], "accepted is name"),
    ],
    ids=["short descriptor", "not finite", "too far", "unknown model", "no reference"],
)
def test_invalid_push_is_one_line(project_root: Path, arguments: list[str], message: str) -> None:
    """An invalid push is one line with exit status 1, or 5 for an unknown model, without a traceback."""
    result = predict(*arguments, registry=project_root / "models")
    assert result.exit_code == (5 if "absent" in arguments else 1)
    assert message in result.output
    assert "Traceback" not in result.output
