"""Folder layout of a copy of Omnipush: surfaces and places of views."""

from pathlib import Path

import pytest

from tests.training.synthetic_omnipush import write_surface
from training.omnipush.layout import SurfaceKind, surface_folders, surface_kind, view_places

OBJECT = "1a2a3a4a"


def test_a_folder_of_pushes_is_its_own_surface(tmp_path: Path) -> None:
    """A folder that holds pushes is a surface, and the folders below it are not searched."""
    write_surface(tmp_path / "abs", [OBJECT], rows=1)
    write_surface(tmp_path / "abs" / "old", [OBJECT], rows=1)

    assert surface_folders(tmp_path / "abs") == [tmp_path / "abs"]


@pytest.mark.parametrize("below", ["", "meta-learning_data/"])
def test_surfaces_are_found_below_the_folder_named(tmp_path: Path, below: str) -> None:
    """Surfaces with the published names are found at the depth of the published tree."""
    for name in ("0,1,2_weights", "plywood", ".cache"):
        write_surface(tmp_path / (below + name), [OBJECT], rows=1)

    assert surface_folders(tmp_path) == [tmp_path / (below + "0,1,2_weights"), tmp_path / (below + "plywood")]


def test_a_folder_without_pushes_has_no_surface(tmp_path: Path) -> None:
    """A folder that holds only other files has no surface."""
    (tmp_path / "abs").mkdir()
    (tmp_path / "abs" / "shape_1a2a3a4a.npy").touch()

    assert surface_folders(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "kind"),
    [("plywood", "plywood"), ("Plywood_2019", "plywood"), ("abs", "abs"), ("0,1,2_weights", "abs"), ("mine", "abs")],
)
def test_plywood_is_recognised_by_its_name(tmp_path: Path, name: str, kind: str) -> None:
    """A folder with plywood in its name is plywood, and every other one is ABS, the benchmark's main surface."""
    assert surface_kind(tmp_path / name) is SurfaceKind(kind)


def test_views_may_be_in_or_beside_the_folders_named(tmp_path: Path) -> None:
    """Views are looked for up to two levels above the pushes, where the release has them beside meta-learning_data."""
    surface = tmp_path / "meta-learning_data" / "plywood"

    assert view_places(surface, [surface]) == {surface, surface.parent}
    assert tmp_path in view_places(surface.parent, [surface])
    assert tmp_path not in view_places(tmp_path / "mine", [tmp_path / "mine"]) - {tmp_path}
