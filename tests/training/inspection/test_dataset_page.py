"""The report page of a dataset: its figures, its pictures, and equal files for equal data."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from training.inspection.dataset_page import GALLERY_FILE, HISTOGRAMS_FILE, REPORT_FILE, gallery, report, write_report
from training.omnipush.pushes import Pushes, read_folder
from training.simulation.dataset import Simulation, simulate_dataset


@pytest.fixture(scope="module")
def pushes(tmp_path_factory: pytest.TempPathFactory) -> Pushes:
    """Ten pushes of three objects."""
    folder = tmp_path_factory.mktemp("pushes")
    simulate_dataset(Simulation(("1a2b3c4a", "2B3a2C1a", "4a4a4a4a"), 10), folder, threads=1, quiet=True)
    return read_folder(folder)


def test_the_report_names_its_data_and_sets_it_beside_the_published(pushes: Pushes) -> None:
    """The page has the source in its title, a row per quantity, and displacement and rotation by quantile."""
    page = report(pushes)

    assert page.startswith("# simulated pushes (quasi-static, plan approach")
    assert pushes.digest in page
    assert "3 objects, 30 pushes" in page
    assert page.count("\n| pusher ") == 3
    assert page.count("\n| object ") == 3
    moved_mm = np.hypot(pushes.outcomes[..., 0], pushes.outcomes[..., 1]) * 1e3
    assert "28.7 % of the recorded ones" in page
    assert "| recorded | 1.8 | 7.8 | 16.5 | 27.4 | 36.4 |" in page
    (row,) = (line for line in page.splitlines() if line.startswith("| displacement"))
    cells = [float(cell) for cell in row.split("|")[2:-1]]
    assert cells[0] == pytest.approx(moved_mm.min(), abs=0.06)
    assert cells[3] == pytest.approx(np.median(moved_mm), abs=0.06)
    assert cells[-1] == pytest.approx(moved_mm.max(), abs=0.06)


def test_the_same_data_gives_the_same_files(pushes: Pushes, tmp_path: Path) -> None:
    """Page and pictures are the same to the bit for the same data, so that a changed picture means changed data."""
    first, second = write_report(pushes, tmp_path / "a"), write_report(pushes, tmp_path / "b")

    assert [path.name for path in first] == [REPORT_FILE, HISTOGRAMS_FILE, GALLERY_FILE]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in first[1:])


def test_the_gallery_shows_every_object_in_turn(pushes: Pushes) -> None:
    """Three objects fill the 24 places, eight pushes of each, titled with displacement and rotation."""
    figure: Figure = gallery(pushes)
    titles = [place.get_title() for place in figure.axes]

    assert Counter(title[:8] for title in titles) == dict.fromkeys(pushes.descriptors, 8)
    assert all(" mm, " in title and title.endswith(" deg") for title in titles)
