"""``cazsl-train simulate shapes``: a table, its rate and the next step, or one line and status 1 or 2."""

import re
from pathlib import Path

import pytest

from tests.training.command_line import cazsl_train, sole_line
from training.tables.reading import read_table


def test_shapes_are_simulated_and_the_rate_is_told(tmp_path: Path) -> None:
    """Held out kinds are absent, and the last lines say how fast it was and how to go on."""
    folder = tmp_path / "shapes"
    options = ["--objects", "3", "--pushes", "4", "--hold-out", "tools", "--hold-out", "blobs", "--jobs", "1"]

    result = cazsl_train("simulate", "shapes", folder, *options)

    assert result.exit_code == 0
    assert [item.name for item in read_table(folder).objects] == ["box-0", "rounded-box-0", "bar-0"]
    assert re.search(r"^12 pushes took \d+ s, \d+ a second on 1 job$", result.stdout, re.MULTILINE)
    assert f"{folder}: 3 objects of 13 families, 12 pushes" in result.stdout
    assert result.stdout.endswith(f"next: cazsl-train data check {folder}\n")

    again = cazsl_train("simulate", "shapes", folder, *options)

    assert f"{folder} holds this table already" in again.stdout
    assert sole_line(cazsl_train("simulate", "shapes", folder, *options, "--seed", "1")).endswith("or remove this one")


def test_a_gallery_is_drawn_instead_of_a_table(tmp_path: Path) -> None:
    """With --gallery only the picture is written, and a name that is no PNG is refused."""
    picture = tmp_path / "shapes.png"

    result = cazsl_train("simulate", "shapes", tmp_path / "none", "--gallery", picture, "--families", "mug")

    assert result.exit_code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "none").exists()
    refused = cazsl_train("simulate", "shapes", "--gallery", tmp_path / "shapes.jpg")
    assert refused.exit_code == 2
    assert "ends in .png" in refused.stderr


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--objects", "0"], "--objects"),
        (["--families", "hammr"], "--families"),
        (["--jobs", "0"], "--jobs"),
    ],
)
def test_impossible_options_are_usage_errors(tmp_path: Path, options: list[str], part: str) -> None:
    """The option is named, and no folder is made."""
    result = cazsl_train("simulate", "shapes", tmp_path / "shapes", *options)

    assert result.exit_code == 2
    assert part in result.stderr
    assert not (tmp_path / "shapes").exists()


def test_no_family_left_and_too_many_pushes_are_one_line(tmp_path: Path) -> None:
    """Choices that exclude each other are told before anything is drawn."""
    nothing_left = cazsl_train("simulate", "shapes", tmp_path, "--families", "mug", "--hold-out", "tools")
    too_many = cazsl_train("simulate", "shapes", tmp_path, "--objects", "1000000")

    assert "no family of shapes is left" in sole_line(nothing_left)
    assert "more than the 10000000 pushes" in sole_line(too_many)
