"""Where the parts of a copy of Omnipush are looked for."""

from pathlib import Path

import pytest

from tests.training.copies import write_surface
from training.omnipush.layout import SurfaceKind, surface_folders, surface_kind, view_places

OBJECT = "1a2a3a4a"


def test_a_folder_of_pushes_is_its_own_surface(tmp_path: Path) -> None:
    """What lies below it is not looked at."""
    write_surface(tmp_path / "abs", [OBJECT], rows=1)
    write_surface(tmp_path / "abs" / "old", [OBJECT], rows=1)

    assert surface_folders(tmp_path / "abs") == [tmp_path / "abs"]


@pytest.mark.parametrize("below", ["", "meta-learning_data/"])
def test_surfaces_are_found_below_the_folder_named(tmp_path: Path, below: str) -> None:
    """The published names are met as they are, at the depth of the published tree."""
    for name in ("0,1,2_weights", "plywood", ".cache"):
        write_surface(tmp_path / (below + name), [OBJECT], rows=1)

    assert surface_folders(tmp_path) == [tmp_path / (below + "0,1,2_weights"), tmp_path / (below + "plywood")]


def test_a_folder_without_pushes_has_no_surface(tmp_path: Path) -> None:
    """Other files do not make one."""
    (tmp_path / "abs").mkdir()
    (tmp_path / "abs" / "shape_1a2a3a4a.npy").touch()

    assert surface_folders(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "kind"),
    [("plywood", "plywood"), ("Plywood_2019", "plywood"), ("abs", "abs"), ("0,1,2_weights", "abs"), ("mine", "abs")],
)
def test_plywood_is_told_by_its_name(tmp_path: Path, name: str, kind: str) -> None:
    """Everything else is the benchmark's main surface."""
    assert surface_kind(tmp_path / name) is SurfaceKind(kind)


def test_views_may_be_in_or_beside_the_folders_named(tmp_path: Path) -> None:
    """As published they are beside meta-learning_data, two levels above the pushes."""
    surface = tmp_path / "meta-learning_data" / "plywood"

    assert view_places(surface, [surface]) == {surface, surface.parent}
    assert tmp_path in view_places(surface.parent, [surface])
    assert tmp_path not in view_places(tmp_path / "mine", [tmp_path / "mine"]) - {tmp_path}
