"""Checks of top-down views: found, missing, broken."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.training.synthetic_omnipush import write_views
from training.inspection.findings import Severity
from training.inspection.views import find_views, missing_views, odd_views
from training.omnipush.views import VIEWS_FOLDER

FIRST, SECOND = "1a2b3c4a", "2B3a3a4a"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Folder with two intact views, laid out as published."""
    write_views(tmp_path / VIEWS_FOLDER / "2_weight", [FIRST])
    write_views(tmp_path / VIEWS_FOLDER / "1_weight", [SECOND])
    return tmp_path


def test_views_are_found_at_any_depth(folder: Path) -> None:
    """Views are found in a folder per number of weights, and images scaled down for others are ignored."""
    write_views(folder / (VIEWS_FOLDER + "32"), [FIRST], size=32)

    assert find_views([folder, folder / "nowhere"]) == {
        FIRST: (folder / VIEWS_FOLDER / "2_weight" / f"shape_{FIRST}.npy",),
        SECOND: (folder / VIEWS_FOLDER / "1_weight" / f"shape_{SECOND}.npy",),
    }


def test_intact_views_have_no_finding(folder: Path) -> None:
    """Views of any numeric type have no finding."""
    for dtype in (np.uint8, np.bool_, np.float32, np.float64):
        path = folder / VIEWS_FOLDER / "2_weight" / f"shape_{FIRST}.npy"
        path.unlink()
        np.save(path, np.ones((481, 481), dtype=dtype))
        assert list(odd_views(find_views([folder]), quiet=True)) == []


def saved(array: npt.NDArray[Any]) -> Callable[[Path], None]:
    """Return damage: the view holds this array."""
    return lambda path: np.save(path, array)


def huge(path: Path) -> None:
    """Damage: the view is far larger than any."""
    with path.open("wb") as file:
        file.truncate(65 * 2**20)


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        pytest.param(saved(np.zeros((32, 32))), "(32, 32); expected (481, 481)", id="another size"),
        pytest.param(saved(np.zeros((481, 481, 3), np.uint8)), "(481, 481, 3); expected (481, 481)", id="colours"),
        pytest.param(saved(np.full((481, 481), np.nan)), "not in [0, 1]", id="NaN"),
        pytest.param(saved(np.full((481, 481), "x")), "an array of <U1", id="text"),
        pytest.param(lambda path: path.write_bytes(b"\x93NUMPY"), "not a complete .npy file", id="cut"),
        pytest.param(
            lambda path: np.save(path, np.array([print], dtype=object), allow_pickle=True),
            "not a complete .npy file",
            id="a pickle",
        ),
        pytest.param(huge, "at most", id="huge"),
    ],
)
def test_a_broken_view_is_named(folder: Path, damage: Callable[[Path], object], fault: str) -> None:
    """A broken view is an error that names the file, as a visual model would be trained on it."""
    path = folder / VIEWS_FOLDER / "2_weight" / f"shape_{FIRST}.npy"
    path.unlink()
    damage(path)

    (finding,) = odd_views(find_views([folder]), quiet=True)
    assert finding.severity is Severity.ERROR
    assert str(path) in finding.message
    assert fault in finding.message


def test_two_views_of_one_object_are_named(folder: Path) -> None:
    """The finding about two views of one object names both files and the remedy."""
    again = folder / VIEWS_FOLDER / "0_weight"
    again.mkdir()
    shutil.copy(folder / VIEWS_FOLDER / "2_weight" / f"shape_{FIRST}.npy", again / f"shape_{FIRST}.npy")

    (finding,) = odd_views(find_views([folder]), quiet=True)
    assert "0_weight" in finding.message
    assert "2_weight" in finding.message
    assert "keep one" in finding.message


def test_a_view_of_no_object_is_named(folder: Path) -> None:
    """A view whose descriptor is not that of an object is reported."""
    write_views(folder / VIEWS_FOLDER / "0_weight", ["1B1a1a1a"])

    (finding,) = odd_views(find_views([folder]), quiet=True)
    assert "shape_1B1a1a1a.npy names no Omnipush object" in finding.message


def test_objects_without_a_view_are_counted(folder: Path) -> None:
    """Objects without a view are a warning, and those with a turned view are counted separately."""
    views = find_views([folder])
    (finding,) = missing_views("abs", [FIRST, "3c4a1a2b", "4a4a4a4a"], views)

    assert list(missing_views("abs", [FIRST, SECOND], views)) == []
    assert finding.severity is Severity.WARNING
    assert "no top-down view of 2 objects (3c4a1a2b, 4a4a4a4a)" in finding.message
    assert "of 1 object (3c4a1a2b) there is one under a turned" in finding.message
