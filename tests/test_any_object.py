"""First questions of a new user: each is asked and answered, or refused with the cure, and drawn."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from benchmarks.any_object import aimed, main, scenes
from benchmarks.any_object_pictures import Backdrop, Panel, draw_panels, moved
from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.shape_context import PUSHER_RADIUS_M
from service.registry.registry import Registry
from tests.served_graphs import publish_shapes

BOX = np.array([(0.06, 0.04), (-0.06, 0.04), (-0.06, -0.04), (0.06, -0.04)])


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """Return a folder with a mask of a disc, and with a dark bar on a light table."""
    mask = Image.new("L", (200, 160), 0)
    ImageDraw.Draw(mask).ellipse((50, 30, 150, 130), fill=255)
    mask.save(tmp_path / "mug.png")
    table = np.random.default_rng(0).normal(180.0, 3.0, (240, 320, 3)).clip(0, 255).astype(np.uint8)
    photograph = Image.fromarray(table)
    ImageDraw.Draw(photograph).rectangle((60, 100, 260, 140), fill=(40, 45, 50))
    photograph.save(tmp_path / "view.png")
    return tmp_path


def test_all_questions_are_answered_or_refused(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Objects move, a miss rests, and a start inside and an empty table are refused with a cure."""
    publish_shapes(Registry(tmp_path / "models"))
    out = tmp_path / "page"
    main(["--models-folder", str(tmp_path / "models"), "--images", str(images), "--out", str(out)])
    answers = json.loads((out / "figures.json").read_text())["answers"]
    assert list(answers) == ["box", "l", "mug", "wrench", "empty"]
    by_title = {answer["push"]["title"]: answer for answer in answers["box"]}
    for name in ("l", "mug", "wrench"):
        assert [answer["push"]["length_m"] for answer in answers[name]] == [0.01, 0.05, 0.1]
        assert all(answer["model"] == "push-shape 1" for answer in answers[name])
    assert by_title["50 mm"]["mean"][0] > 0.02
    assert by_title["misses"]["mean"] == [0.0, 0.0, 0.0]
    for refused in (by_title["starts inside"], *answers["empty"]):
        assert refused["mean"] is None
        assert "accepted is" in refused["refusal"]
    page = (out / "README.md").read_text()
    assert page.count("](") == len(answers)
    assert '"metres_per_pixel": 0.0004' in page
    assert page.count("**refused**") == 2
    assert str(tmp_path) not in page
    for name in answers:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert "refused: " in capsys.readouterr().out


def test_pushes_that_are_aimed_at_an_outline_start_near_it_and_meet_it() -> None:
    """All three start clear of the outline, within 4 mm, and reach it."""
    outline = Outline.of(BOX + np.array([0.02, 0.01]))
    pushers = np.array([[*push.pusher, push.length_m] for push in aimed(outline.corners)])
    travel = first_contact(outline, pushers, PUSHER_RADIUS_M).travel_m
    assert (travel > 0.0).all()
    assert travel == pytest.approx(0.003, abs=0.001)
    assert pushers[:, 3].tolist() == [0.01, 0.05, 0.1]


def test_pictures_of_the_documentation_are_asked_with_their_scale(images: Path) -> None:
    """Outlines and pictures are the contexts, and the box of the page measures 120 x 80 mm."""
    box, letter, *pictures = scenes(images)
    assert np.ptp(np.array(box.corners), axis=0) == pytest.approx([0.12, 0.08])
    assert letter.context.outline is not None
    assert [scene.context.metres_per_pixel for scene in pictures] == [0.0004] * 3
    assert all(scene.context.image for scene in pictures)


def test_a_motion_turns_about_the_origin_and_then_shifts() -> None:
    """A quarter turn takes x to y, before the shift."""
    found = moved(np.array([[1.0, 0.0]]), np.array([0.5, 0.25, math.pi / 2]))
    assert found[0] == pytest.approx([0.5, 1.25])


def test_a_refused_push_is_drawn_without_an_answer(tmp_path: Path) -> None:
    """Panels with and without object, pusher and answer are drawn, and an answer adds blue."""
    pusher = np.array([-0.07, 0.0, 0.0, 0.05])
    answered = Panel("50 mm", BOX, pusher, 0.005, np.array([0.04, 0.0, 0.1]), np.array([0.002, 0.003, 0.1]), "")
    refused = Panel("inside", BOX, pusher, 0.005, None, None, "refused: the reason")
    backdrop = Backdrop(np.full((120, 200, 4), 200, dtype=np.uint8), 0.001)
    blue = []
    for name, panels in (
        ("answered", [answered]),
        ("refused", [refused, Panel("", None, None, 0.005, None, None, "")]),
    ):
        draw_panels(tmp_path / f"{name}.png", panels, backdrop)
        with Image.open(tmp_path / f"{name}.png") as picture:
            red, _, strong = np.moveaxis(np.asarray(picture.convert("RGB")).astype(int), 2, 0)
        blue.append(int((strong - red > 100).sum()))
    assert blue[0] > 100
    assert blue[1] == 0
