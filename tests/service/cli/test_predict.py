"""Tests of ``cazsl predict`` for one push. ``tests/service/bulk/test_predict_file.py`` tests files of pushes."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from service.cli.main import main
from service.client import Client
from service.schemas.contexts import ContextBody
from service.schemas.shapes import OUTLINE_EXAMPLE
from tests.service.schemas.test_shapes import box_picture, two_boxes


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
    assert answer["warnings"] == []
    strange = predict("1a2b3c4a", "--", "-0.5", "0", "0", registry=project_root / "models")
    assert json.loads(strange.output)["warnings"][0]["code"] == "no_contact"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["1a2b3c", "--", "0", "0", "0"], "8 characters"),
        (["1a2b3c4a", "--", "nan", "0", "0"], "body.pusher.x: received a number that is not finite"),
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


@pytest.fixture(scope="module")
def with_shapes(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """A registry with a model of every kind of context."""
    root = tmp_path_factory.mktemp("registry") / "models"
    shutil.copytree(project_root / "models", root)
    return root


def test_an_outline_in_a_file_is_pushed_by_any_length(with_shapes: Path, tmp_path: Path) -> None:
    """A context in JSON and options for its details give the answer of the client."""
    (tmp_path / "box.json").write_text(json.dumps({"outline": OUTLINE_EXAMPLE}))
    options = ("--context", str(tmp_path / "box.json"), "--length", "0.02", "--friction", "0.3")
    details = ("--centre-of-mass", "0.01", "0", "--pressure", "1", "0", "-1")
    result = predict(*options, *details, "--", "-0.1", "0", "0", registry=with_shapes)
    assert result.exit_code == 0, result.output
    context = ContextBody(outline=OUTLINE_EXAMPLE, friction=0.3, centre_of_mass=[0.01, 0.0], pressure=[1.0, 0.0, -1.0])
    with Client.local(str(with_shapes)) as client:
        answer = client.predict([-0.1, 0.0, 0.0], context, length=0.02)
    assert json.loads(result.output) == answer.model_dump(exclude_none=True)
    assert answer.model.name == "push-shape"


def test_an_image_is_an_outline_with_its_scale(with_shapes: Path, tmp_path: Path) -> None:
    """With --metres-per-pixel the model of shapes answers, and without it that of visual contexts."""
    (tmp_path / "view.png").write_bytes(box_picture())
    for options, name in (((), "push-visual"), (("--metres-per-pixel", "0.0005"), "push-shape")):
        result = predict("--image", str(tmp_path / "view.png"), *options, "--", "-0.1", "0", "0", registry=with_shapes)
        assert result.exit_code == 0, result.output
        assert json.loads(result.output)["model"]["name"] == name


def test_faults_of_an_image_come_with_the_prediction(with_shapes: Path, tmp_path: Path) -> None:
    """A second object in a picture is a warning, and so is an angle that looks like degrees."""
    (tmp_path / "two.png").write_bytes(two_boxes())
    options = ("--image", str(tmp_path / "two.png"), "--metres-per-pixel", "0.0005")
    result = predict(*options, "--", "-0.1", "0", "360", registry=with_shapes)
    assert result.exit_code == 0, result.output
    codes = {warning["code"] for warning in json.loads(result.output)["warnings"]}
    assert codes >= {"image_several_objects", "angle_looks_like_degrees"}


def test_a_setting_names_the_default_model(with_shapes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """CAZSL_MODEL_INDICATOR counts as it does for the service."""
    monkeypatch.setenv("CAZSL_MODEL_INDICATOR", "absent")
    result = predict("1a2b3c4a", "--", "-0.1", "0", "0", registry=with_shapes)
    assert "there is no model absent" in result.output


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        ("[]", (), "received JSON that is no object"),
        ("{", (), "received no JSON"),
        ('{"outline": [[0, 0], [1, 1]]}', (), "body.context.outline: received 2 values"),
        ('{"outline": [[0, 0], [1, 1], [0, 1]]}', ("--metres-per-pixel", "0.01"), "body.context.metres_per_pixel"),
        ('{"descriptor": "1a2b3c4a"}', ("--length", "0.1"), "body.pusher.length: received 0.1 m"),
        ('{"descriptor": "1a2b3c4a"}', ("--parquet", "a", "b"), "reads pushes and objects from IN alone"),
    ],
)
def test_a_file_that_is_no_context_is_one_line(
    with_shapes: Path, tmp_path: Path, content: str, options: tuple[str, ...], message: str
) -> None:
    """Each fault is one line without a traceback."""
    (tmp_path / "context.json").write_text(content)
    pose = () if "--parquet" in options else ("--", "-0.1", "0", "0")
    result = predict("--context", str(tmp_path / "context.json"), *options, *pose, registry=with_shapes)
    assert result.exit_code != 0
    assert message in result.output
    assert "Traceback" not in result.output
