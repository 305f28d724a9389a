"""Bands of pushes: every push is in its band, and a version is scored by each of them, on tables made here."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import omnipush_outlines
from benchmarks.push_bands import EDGES, FAMILY, SPREAD, bands, features
from benchmarks.push_predictions import quasi_static
from benchmarks.shape_bands import main
from benchmarks.shape_predictions import _parts, starts_outside
from service.pushing.contexts import ObjectContext
from service.pushing.outlines import Outline
from service.registry.registry import Registry
from tests.served_graphs import publish_shapes
from training.omnipush.pushes import read_folder, write_object
from training.tables.push_table import PushTable, TableObject, TextColumn
from training.tables.writing import write_table

BOX = [[0.05, 0.03], [-0.05, 0.03], [-0.05, -0.03], [0.05, -0.03]]
WEDGE = [[0.06, -0.02], [0.0, 0.04], [-0.06, -0.02]]
TIP_M = 0.005


def table(*rows: tuple[float, float, float, float], repeats: int = 1) -> PushTable:
    """Return a table of the same pushes of a box and of a wedge, 5 mm from where mechanics expects them."""
    pushers = np.tile(np.array(rows), (2 * repeats, 1))
    count = len(pushers)
    found = PushTable(
        objects=(
            TableObject("box", Outline.of(BOX), (0.01, 0.0), friction=0.3),
            TableObject("wedge", Outline.of(WEDGE), (0.0, 0.0)),
        ),
        object_index=np.arange(count) // (count // 2),
        pushers=pushers,
        outcomes=np.zeros((count, 3)),
        pusher_radius_m=np.full(count, TIP_M),
        surfaces=("table",),
        surface_index=np.zeros(count, dtype=np.int64),
        source="made for a test",
        digest="0" * 64,
        labels={FAMILY: TextColumn(("box", "wedge"), np.arange(count) // (count // 2))},
    )
    return replace(found, outcomes=quasi_static(found) + np.array([0.003, 0.004, 0.0]))


@pytest.fixture
def models(tmp_path: Path, project_root: Path) -> Path:
    """Return a registry with the small graph of shapes and a model of Omnipush's objects."""
    folder = tmp_path / "models"
    shutil.copytree(project_root / "models" / "push-indicator", folder / "push-indicator")
    publish_shapes(Registry(folder))
    return folder


def test_features_are_those_of_a_push_that_can_be_computed_by_hand() -> None:
    """Gap, offset and angle of a push along x at a box are those of its geometry, and a miss has none."""
    found = features(table((-0.075, 0.01, 0.0, 0.03), (-0.075, 0.05, 0.0, 0.03), (-0.065, 0.0, math.pi / 4, 0.05)))
    gap, offset, angle, length, size, radius = (found.values[name][:3] for name in EDGES)
    box = Outline.of(BOX)
    assert found.touches[:3].tolist() == [True, False, True]
    assert gap[0] == pytest.approx(20.0)
    assert offset[0] == pytest.approx(0.01 / box.size_m)
    assert angle[0] == pytest.approx(0.0, abs=1e-4)
    assert angle[2] == pytest.approx(45.0)
    assert (length[0], size[0], radius[0]) == pytest.approx((30.0, 1e3 * box.size_m, 5.0))
    assert np.isnan([gap[1], offset[1], angle[1], length[1]]).all()


def test_every_touching_push_is_in_one_band_of_each_kind() -> None:
    """Bands neither overlap nor leave out a push that touches, at their edges too."""
    rng = np.random.default_rng(1)
    bearing = rng.uniform(-math.pi, math.pi, 200)
    starts = 0.08 * np.column_stack([np.cos(bearing), np.sin(bearing)])
    aims = bearing + math.pi + rng.uniform(-0.9, 0.9, 200)
    lengths = rng.choice([0.005, 0.01, 0.04, 0.08, 0.12], 200)
    pushes = table(*np.column_stack([starts, aims, lengths]).tolist())
    found = features(pushes)
    assert 0 < found.touches.sum() < pushes.count
    for kind, groups in bands(pushes, found).items():
        together = np.sum(list(groups.values()), axis=0)
        expected = np.ones(pushes.count) if kind == SPREAD else found.touches.astype(float)
        assert (together == expected).all(), kind


def test_requests_stay_below_the_limits_of_a_body_and_hold_every_push_once() -> None:
    """A request has at most 10,000 pushes, 1,000 objects, and 50,000 pushes and corners."""
    rng = np.random.default_rng(2)
    index, corners = rng.integers(0, 3000, 40_000), np.where(np.arange(3000) < 900, 300, 3)
    index[:15_000] = 0  # one object with more pushes than a request may have
    parts = list(_parts(index, corners))
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(index)))
    for part in parts:
        assert len(part) <= 10_000
        assert len(np.unique(index[part])) <= 1000
        assert len(part) + corners[np.unique(index[part])].sum() <= 50_000


def test_a_start_inside_is_found() -> None:
    """The tip's centre decides: inside of the box, and beside it."""
    assert starts_outside(table((0.0, 0.0, 0.0, 0.05), (-0.052, 0.0, 0.0, 0.05)))[:2].tolist() == [False, True]


def test_the_page_has_every_band_and_the_summary_of_the_goals(
    models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A version is asked with and without the body, beside mechanics, which is off by a known error."""
    rows = [(-0.08, y / 1000.0, 0.02 * y / 10.0, length) for y in range(-20, 21, 4) for length in (0.03, 0.05, 0.09)]
    rows += [(-0.08, 0.09, 0.0, 0.05), (0.0, 0.0, 0.0, 0.05)]  # one misses, and one starts inside and is left out
    write_table(tmp_path / "table", table(*rows, repeats=10))
    out = tmp_path / "page"
    main([str(tmp_path / "table"), "--models-folder", str(models), "--held-out", "wedge", "--out", str(out)])
    text = capsys.readouterr().out
    assert "| touching | mechanics | 580 | 5.00 (5.00) |" in text
    figures = json.loads((out / "figures.json").read_text())
    assert figures["version"] == "push-shape@1"
    assert figures["pushes"] == 680
    assert figures["command"] == "python -m benchmarks.shape_bands TABLE --model push-shape --held-out wedge"
    summary = figures["summary"]
    assert summary["mechanics.position_mm"] == pytest.approx(5.0)
    assert summary["mechanics.held_out_over_seen"] == pytest.approx(1.0)
    assert summary["outline_alone.held_out_over_seen"] > 0.0
    assert 0.0 <= summary["body_known.lowest_intervals_90"] <= summary["body_known.highest_intervals_90"] <= 1.0
    page = (out / "README.md").read_text()
    assert "push-shape@1" in page
    assert "data/shapes" not in page
    for kind in (*EDGES, FAMILY, "families"):
        assert f"## {kind}\n" in page
    assert (out / "bands.png").read_bytes().startswith(b"\x89PNG")


def test_a_held_out_family_that_is_not_there_ends_in_one_line(models: Path, tmp_path: Path) -> None:
    """The families that can be named are listed."""
    write_table(tmp_path / "table", table((-0.08, 0.0, 0.0, 0.05)))
    with pytest.raises(SystemExit, match=r"--held-out: .* box, wedge"):
        main([str(tmp_path / "table"), "--models-folder", str(models), "--held-out", "mug"])


def test_objects_of_omnipush_are_asked_by_outline_and_by_descriptor(
    models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All pushes are answered three times, and the ratio is that of the RMSE of the page."""
    rng = np.random.default_rng(3)
    folder, out = tmp_path / "pushes", tmp_path / "page"
    folder.mkdir()
    for descriptor in ("1a2b3c4a", "4a4a4a4a"):
        pushers = np.column_stack([np.full(20, -0.09), rng.uniform(-0.02, 0.02, 20), np.zeros(20)])
        write_object(folder, descriptor, pushers, np.tile([0.03, 0.0, 0.0], (20, 1)))
    omnipush_outlines.main([str(folder), "--models-folder", str(models), "--out", str(out)])
    assert capsys.readouterr().out.count("| all | 40 |") == 3
    figures = json.loads((out / "figures.json").read_text())
    names = ["push-shape@1, centre of mass known", "push-shape@1, outline alone"]
    assert list(figures["summary"]) == names
    scores = figures["scores"]
    assert set(scores[names[0]]) == {"all", "no weight", "two weights"}
    ratio = scores[names[0]]["all"]["rmse"] / scores[figures["beside"]]["all"]["rmse"]
    assert figures["summary"][names[0]] == pytest.approx(ratio, rel=1e-4)


def test_an_object_of_omnipush_keeps_its_weights_as_a_centre_of_mass(tmp_path: Path) -> None:
    """A weight at side 3 draws the centre of mass to the left, and an even object has it in its origin."""
    for descriptor in ("4a4a4a4a", "4a4a4c4a"):
        write_object(tmp_path, descriptor, np.array([[-0.09, 0.0, 0.0]]), np.zeros((1, 3)))
    found = omnipush_outlines.table_of(read_folder(tmp_path))
    centres = {item.name: item.centre_of_mass_m for item in found.objects}
    assert centres["4a4a4a4a"] == pytest.approx((0.0, 0.0), abs=1e-12)
    loaded = centres["4a4a4c4a"]
    assert loaded is not None
    assert loaded[0] < -0.005
    assert loaded[1] == pytest.approx(0.0, abs=1e-12)
    assert ObjectContext.from_descriptor(found.objects[0].name)
