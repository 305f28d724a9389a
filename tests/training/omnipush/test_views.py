"""Reading of top-down views: any numeric type, the folders of the release, and broken files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from service.errors import DataError
from service.pushing.contexts import ObjectContext
from service.pushing.images import IMAGE_CONVENTION, GreyImage, visual_context
from tests.training.pickle_trap import PickleTrap
from training.omnipush.views import (
    UNKNOWN_CONVENTION,
    convention_of,
    read_camera_views,
    read_views,
    source_of,
    views_beside,
)
from training.simulation.drawing import top_down_view, write_views

OBJECTS = ("1a2a3a4a", "2C3b1a4a", "4a4c1a3b")


def view_of(descriptor: str) -> npt.NDArray[np.uint8]:
    """Draw the view of an object."""
    return top_down_view(ObjectContext.from_descriptor(descriptor))


def write_view(folder: Path, array: npt.NDArray[Any], name: str = "shape_1a2a3a4a.npy") -> Path:
    """Write a file of views as other people may have written it."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / name, array, allow_pickle=True)
    return folder / name


def test_the_order_of_objects_is_the_caller_s(tmp_path: Path) -> None:
    """Row i is object i of the request, in any order of drawing."""
    write_views(tmp_path, OBJECTS, quiet=True)
    assert np.array_equal(read_views(tmp_path, OBJECTS[::-1]), read_views(tmp_path, OBJECTS)[::-1])
    assert read_views(tmp_path, ()).shape == (0, 1, 32, 32)


def test_a_folder_declares_how_its_views_were_made(tmp_path: Path) -> None:
    """Drawn folders declare our convention, source and seed, and undeclared folders are not claimed to be drawn."""
    write_views(tmp_path / "ours", (), quiet=True)
    (tmp_path / "theirs").mkdir()
    (tmp_path / "pushes").mkdir()
    (tmp_path / "pushes" / "dataset.json").write_text('{"source": "pushes"}', encoding="utf-8")
    assert convention_of(tmp_path / "ours") == IMAGE_CONVENTION
    assert convention_of(tmp_path / "theirs") == UNKNOWN_CONVENTION
    assert source_of(tmp_path / "theirs") == "top-down views of undeclared origin"
    write_views(tmp_path / "camera", (), camera=True, seed=7, quiet=True)
    assert source_of(tmp_path / "ours") == "simulated top-down views"
    assert source_of(tmp_path / "camera") == "simulated top-down views (camera, seed 7)"
    with pytest.raises(DataError, match=r"dataset\.json is not JSON with a key 'image_convention'"):
        convention_of(tmp_path / "pushes")


def test_the_folders_of_the_release_are_searched(tmp_path: Path) -> None:
    """Views are found in 0_weight, 1_weight and 2_weight below the folder."""
    write_views(tmp_path / "flat", OBJECTS, quiet=True)
    for weights, descriptor in zip("021", OBJECTS, strict=True):
        name = f"shape_{descriptor}.npy"
        write_view(tmp_path / "sorted" / f"{weights}_weight", np.load(tmp_path / "flat" / name), name)
    assert np.array_equal(read_views(tmp_path / "sorted", OBJECTS), read_views(tmp_path / "flat", OBJECTS))


@pytest.mark.parametrize(
    "convert",
    [
        lambda view: view / 255.0,
        lambda view: (view / 255.0).astype(np.float32),
        lambda view: view.astype(np.float64),
        lambda view: view.astype(np.int64),
        lambda view: view.astype(">i4"),
        lambda view: view.astype(np.uint16) * 257,
        lambda view: np.asfortranarray(view),
    ],
    ids=["fractions", "fractions of 32 bits", "0 to 255", "int64", "big-endian", "16 bits", "column by column"],
)
def test_any_numeric_type_is_read(tmp_path: Path, convert: Callable[[Any], npt.NDArray[Any]]) -> None:
    """Every numeric type with the same grey levels gives the same context, as the published type is not known."""
    view = view_of("1a2a3a4a")
    write_view(tmp_path, convert(view))
    assert read_views(tmp_path, ["1a2a3a4a"]).tobytes() == visual_context(GreyImage(view)).levels


def test_a_black_and_white_mask_is_read(tmp_path: Path) -> None:
    """A view may be boolean, or whole numbers where 1 is white."""
    mask = view_of("1a2a3a4a") > 0
    expected = visual_context(GreyImage(mask.astype(np.uint8) * 255)).levels
    for array in (mask, mask.astype(np.int32), mask.astype(np.float64)):
        write_view(tmp_path, array)
        assert read_views(tmp_path, ["1a2a3a4a"]).tobytes() == expected


def trap_beside(path: Path) -> PickleTrap:
    """Return a trap that makes the folder ``sprung`` beside a file."""
    return PickleTrap(path.parent / "sprung")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda path: path.unlink(), "is missing; fetch it, or draw"),
        (lambda path: path.write_bytes(b""), "not a complete .npy"),
        (lambda path: path.write_bytes(path.read_bytes()[:5000]), "not a complete .npy"),
        (lambda path: path.write_bytes(b"PK\3\4" + bytes(100)), "not a complete .npy"),
        (lambda path: path.write_bytes(bytes(3_000_000)), "at most"),
        (lambda path: np.save(path, np.zeros((480, 480))), r"shape \(480, 480\); expected \(481, 481\)"),
        (lambda path: np.save(path, np.zeros((481, 481, 3), np.uint8)), r"shape \(481, 481, 3\)"),
        (lambda path: np.save(path, np.full((481, 481), np.nan)), "not in"),
        (lambda path: np.save(path, np.full((481, 481), -1)), "not in"),
        (lambda path: np.save(path, np.full((481, 481), 300.0)), "not in"),
        (lambda path: np.save(path, np.full((481, 481), 1j, np.complex64)), "complex64"),
        (lambda path: np.save(path, np.array([trap_beside(path)]), allow_pickle=True), "not a complete .npy"),
        (lambda path: write_view(path.parent / "1_weight", np.load(path)), "the same object; keep one"),
    ],
    ids=[
        "missing", "empty", "truncated", "an archive", "too long", "another size", "colour", "NaN", "negative",
        "beyond 255", "complex", "a pickle", "two files",
    ],
)  # fmt: skip
def test_a_file_that_is_not_a_view_is_refused_by_name(
    tmp_path: Path, spoil: Callable[[Path], object], words: str
) -> None:
    """The error about a broken view is one line with its file, fault and remedy, and a pickle is never loaded."""
    path = write_view(tmp_path, view_of("1a2a3a4a"))
    spoil(path)
    with pytest.raises(DataError, match=words) as raised:
        read_views(tmp_path, ["1a2a3a4a"])
    assert str(path.name) in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "sprung").exists()


def test_a_missing_folder_of_views_is_named(tmp_path: Path) -> None:
    """The error about a missing folder names it and the command that would fill it."""
    with pytest.raises(DataError, match="nowhere is not a folder of top-down views; run 'cazsl-train images"):
        read_views(tmp_path / "nowhere", OBJECTS)


@pytest.mark.parametrize(
    "array",
    [
        pytest.param(np.zeros((1, 32, 32), dtype=np.uint8), id="fewer views"),
        pytest.param(np.zeros((4, 16, 16), dtype=np.uint8), id="smaller views"),
        pytest.param(np.zeros((4, 32, 32)), id="fractions"),
        pytest.param(None, id="missing"),
    ],
)
def test_camera_views_that_cannot_be_used_are_named(tmp_path: Path, array: npt.NDArray[Any] | None) -> None:
    """A file that is missing, or holds anything but enough 32 x 32 bytes, is named with the command that draws it."""
    if array is not None:
        np.save(tmp_path / "cameras_1a2a3a4a.npy", array)
    with pytest.raises(DataError, match=r"cameras_1a2a3a4a\.npy .*cazsl-train images --camera --views 3"):
        read_camera_views(tmp_path, ["1a2a3a4a"], 3)


def test_views_lie_beside_the_folder_of_a_surface(tmp_path: Path) -> None:
    """The default folder of views is the one beside a surface, with the name of the release."""
    assert views_beside(tmp_path / "abs") == tmp_path / "top-down_view"
