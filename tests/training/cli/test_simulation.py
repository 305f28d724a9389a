"""``cazsl-train simulate`` and ``images``: files, figures and the next step, or one line and status 1."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.training.command_line import cazsl_train, sole_line
from tests.training.synthetic_omnipush import write_linked_views
from training.omnipush.declaration import declare_dataset
from training.omnipush.published import different_surfaces, omnipush_descriptors
from training.omnipush.pushes import read_folder
from training.omnipush.views import VIEWS_FOLDER, camera_views_file_name, view_file_name
from training.simulation.dataset import Simulation
from training.simulation.drawing import write_camera_views, write_views


def test_simulate_continues_and_describes_the_dataset(data_folder: Path, tmp_path: Path) -> None:
    """Two missing objects of 250 are simulated, and the whole folder is described beside the published statistics."""
    folder, left = tmp_path / "abs", omnipush_descriptors()[3:5]
    declare_dataset(folder, Simulation(omnipush_descriptors(), pushes_per_object=2, seed=4).declaration())
    for path in data_folder.glob("*.npy"):
        if not path.name.startswith(left):
            shutil.copy(path, folder / path.name)
    missing_view = tmp_path / VIEWS_FOLDER / view_file_name(omnipush_descriptors()[1])
    write_linked_views(missing_view.parent, without=missing_view.name)

    result = cazsl_train("simulate", tmp_path, *["--surface", "abs", "--pushes", "2", "--seed", "4", "--threads", "1"])

    found = read_folder(folder)
    assert result.exit_code == 0
    assert f"{found.source}: 250 objects, {found.count} pushes" in result.stdout
    assert found.digest in result.stdout
    assert "object yaw_rad" in result.stdout
    assert re.search(r"^4 pushes took \d+ s, [\d.]+ ms a push$", result.stdout, re.MULTILINE)
    assert result.stdout.endswith(f"next: cazsl-train fit push-indicator --data {folder}\n")
    assert found.valid[[found.descriptors.index(descriptor) for descriptor in left]].sum(axis=1).tolist() == [2, 2]
    assert missing_view.is_file()


def test_simulate_pushes_the_published_ten_on_plywood(tmp_path: Path) -> None:
    """A surface has a folder of its own, and its source names the surface."""
    result = cazsl_train("simulate", tmp_path, *["--surface", "plywood", "--pushes", "1", "--threads", "1"])

    found = read_folder(tmp_path / "plywood")
    assert result.exit_code == 0
    assert found.descriptors == different_surfaces().test
    assert "PLYWOOD" in found.source
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plywood", "top-down_view"]
    assert len(list((tmp_path / "top-down_view").glob("shape_*.npy"))) == 10


def test_simulate_is_a_group_whose_first_command_is_the_default(tmp_path: Path) -> None:
    """A named first command and none of them write the same bytes, and the help of the group shows both."""
    options = ["--surface", "plywood", "--pushes", "1", "--threads", "1"]
    named, unnamed = tmp_path / "named", tmp_path / "unnamed"

    assert cazsl_train("simulate", "omnipush", named, *options).exit_code == 0
    assert cazsl_train("simulate", *options, unnamed).exit_code == 0
    assert read_folder(named / "plywood").digest == read_folder(unnamed / "plywood").digest
    assert "\n  omnipush " in cazsl_train("simulate", "--help").output


def test_simulate_names_the_plan_in_the_source(tmp_path: Path) -> None:
    """The plan ring has the source of the committed tables, the default one its name."""
    options = ["--surface", "plywood", "--pushes", "1", "--threads", "1"]
    ring = cazsl_train("simulate", tmp_path / "ring", "--plan", "ring", *options)
    approach = cazsl_train("simulate", tmp_path / "approach", *options)

    assert re.search(r"simulated pushes \(MuJoCo [\d.]+, PLYWOOD, seed 0\)", ring.stdout)
    assert "plan approach, PLYWOOD, seed 0)" in approach.stdout


def test_simulate_has_the_share_of_misses_as_a_setting(tmp_path: Path) -> None:
    """With half of the pushes missing, half of them and a few more leave the object, and the folder declares it."""
    options = ["--surface", "plywood", "--pushes", "20", "--miss-share", "0.5"]
    result = cazsl_train("simulate", tmp_path / "data", *options)

    found = re.search(r"([\d.]+) % missed the object", result.stdout)
    assert found is not None
    assert 50.0 <= float(found[1]) < 62.0
    assert '"miss_share": 0.5' in (tmp_path / "data" / "plywood" / "dataset.json").read_text()
    refused = cazsl_train("simulate", tmp_path / "ring", *options, "--plan", "ring")
    assert refused.exit_code == 2
    assert "--miss-share is for the plan approach" in refused.stderr


def test_simulate_names_the_plans_that_there_are(tmp_path: Path) -> None:
    """An unknown plan is a usage error that lists the known ones."""
    result = cazsl_train("simulate", tmp_path, "--plan", "circle")

    assert result.exit_code == 2
    assert "approach" in result.stderr
    assert "ring" in result.stderr


def test_simulate_refuses_a_folder_of_other_pushes(data_folder: Path, tmp_path: Path) -> None:
    """The error about a folder with other pushes names it, and the folder is not changed."""
    folder = shutil.copytree(data_folder, tmp_path / "abs")

    assert str(folder) in sole_line(cazsl_train("simulate", tmp_path, "--pushes", "1"))
    assert read_folder(folder).digest == read_folder(data_folder).digest


@pytest.mark.parametrize("count", ["0", "-1", "many"])
def test_simulate_refuses_an_impossible_number_of_pushes(tmp_path: Path, count: str) -> None:
    """An impossible number of pushes is a usage error, and no folder is made."""
    result = cazsl_train("simulate", tmp_path, "--pushes", count)

    assert result.exit_code == 2
    assert "--pushes" in result.stderr
    assert not (tmp_path / "abs").exists()


def test_images_draws_missing_views(tmp_path: Path) -> None:
    """A missing view is drawn, and folder, number of views and digest of the contexts are printed."""
    missing = tmp_path / view_file_name(omnipush_descriptors()[1])
    write_linked_views(tmp_path, without=missing.name)

    result = cazsl_train("images", tmp_path)

    assert result.exit_code == 0
    assert missing.is_file()
    assert "250 views of 481 x 481" in result.output
    assert "next: cazsl-train images --gallery" in result.output


def test_images_of_another_kind_are_not_mixed_into_a_folder(tmp_path: Path) -> None:
    """The error about camera views for a folder of clean ones names the declaration."""
    write_views(tmp_path, (), quiet=True)

    assert "dataset.json declares another dataset" in sole_line(cazsl_train("images", tmp_path, "--camera"))


def test_images_draws_many_camera_views_for_training(tmp_path: Path) -> None:
    """With --camera and --views the folder gets a file of camera views for each object that lacks one."""
    write_camera_views(tmp_path, (), 2, quiet=True)
    for descriptor in omnipush_descriptors()[1:]:
        np.save(tmp_path / camera_views_file_name(descriptor), np.zeros((2, 32, 32), dtype=np.uint8))

    result = cazsl_train("images", tmp_path, "--camera", "--views", "2")

    assert result.exit_code == 0
    assert np.load(tmp_path / camera_views_file_name(omnipush_descriptors()[0])).any()
    assert "2 camera views of each of 250 objects" in result.output
    assert "Add --camera" in cazsl_train("images", tmp_path, "--views", "2").stderr


def test_images_can_draw_a_gallery_alone(tmp_path: Path) -> None:
    """With --gallery a PNG is written, and no folder of views."""
    result = cazsl_train("images", tmp_path / "views", "--gallery", tmp_path / "views.png")

    assert result.exit_code == 0
    assert (tmp_path / "views.png").read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "views").exists()
