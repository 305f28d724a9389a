"""Refinement measured: supports are drawn as stated, learners learn, and the page has the figures."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import refine
from benchmarks.refine_learners import FittedMechanics, Predicted, Pushes, _centred, _from_centre
from benchmarks.refine_measures import FEWEST, Group, _folds, groups_of, loaded_groups, measure
from service.pushing.mechanics import push
from service.pushing.outlines import Outline
from training.tables.push_table import PushTable, TableObject
from training.tables.writing import write_table

BOX = Outline.of([[0.05, 0.03], [-0.05, 0.03], [-0.05, -0.03], [0.05, -0.03]])
TIP_M = 0.00475
CENTRE = np.array([0.02, 0.0])


def box_pushes(count: int) -> Pushes:
    """Return pushes of a loaded box from all around, as mechanics has them."""
    rng = np.random.default_rng(0)
    angle, aside = rng.uniform(-np.pi, np.pi, count), rng.uniform(-0.03, 0.03, count)
    x, y = -0.08 * np.cos(angle) - aside * np.sin(angle), -0.08 * np.sin(angle) + aside * np.cos(angle)
    pushers = np.column_stack([x, y, angle, np.full(count, 0.05)])
    return Pushes(BOX, TIP_M, pushers, push(BOX, pushers, TIP_M, 0.25, CENTRE, arm=1.1))


def table(pushes: Pushes) -> PushTable:
    """Return a table of pushes of one object."""
    count = len(pushes.pushers)
    return PushTable(
        objects=(TableObject("box", pushes.outline),),
        object_index=np.zeros(count, dtype=np.int64),
        pushers=pushes.pushers,
        outcomes=pushes.outcomes,
        pusher_radius_m=np.full(count, TIP_M),
        surfaces=("table",),
        surface_index=np.zeros(count, dtype=np.int64),
        source="made for a test",
        digest="0" * 64,
    )


class Echo:
    """Learner that predicts the first outcome of its support, and names its first push an outlier."""

    def __call__(self, support: Pushes, asked: Pushes) -> Predicted:
        """See ``Learner``."""
        first = support.outcomes[0] if len(support.outcomes) else np.zeros(3)
        count = len(asked.pushers)
        return Predicted(np.tile(first, (count, 1)), np.ones((count, 3)), (0,) if len(support.outcomes) else ())


def test_supports_contain_each_other_and_are_never_predicted() -> None:
    """The first pushes of a repeat stay when more are told, and no told push is among those asked."""
    group = Group("box", box_pushes(FEWEST))
    few, many = (next(_folds(group, k, 1, 0, False)) for k in (3, 10))
    assert many[0].pushers[:3].tolist() == few[0].pushers.tolist()
    assert few[1].pushers.tolist() == many[1].pushers.tolist()
    asked = {tuple(row) for row in many[1].pushers.tolist()}
    assert not asked & {tuple(row) for row in many[0].pushers.tolist()}
    assert len(asked) == FEWEST - 50


def test_a_fifth_of_the_outcomes_is_replaced() -> None:
    """Wrong outcomes are those that are marked, about one in five, and those to predict stay right."""
    group = Group("box", box_pushes(FEWEST))
    share = []
    for (right, _, _), (wrong, asked, marked) in zip(
        _folds(group, 50, 20, 0, False), _folds(group, 50, 20, 0, True), strict=True
    ):
        changed = (right.outcomes != wrong.outcomes).any(axis=1)
        assert not (changed & ~marked).any()
        share.append(marked.mean())
        assert asked.outcomes == pytest.approx(push(BOX, asked.pushers, TIP_M, 0.25, CENTRE, arm=1.1))
    assert np.mean(share) == pytest.approx(0.2, abs=0.04)


def test_measures_are_means_over_all_predicted_pushes() -> None:
    """A learner that predicts no motion has the mean length of the motions as its error."""
    group = Group("box", box_pushes(FEWEST))
    asked = next(_folds(group, 0, 1, 0, False))[1].outcomes
    found = measure(Echo(), [group], 0, 1, 0)
    assert found.position_mm == pytest.approx(1e3 * np.hypot(asked[:, 0], asked[:, 1]).mean())
    assert found.yaw_deg == pytest.approx(np.degrees(np.abs(asked[:, 2])).mean())
    assert (found.region, found.found, found.false) == (1.0, None, None)
    named = measure(Echo(), [group], 2, 8, 0, outliers=True)
    assert named.found is not None
    assert named.false is not None
    assert 0.0 <= named.found <= 1.0
    assert 0.2 < named.false < 0.8


def test_fitted_mechanics_finds_the_parameters() -> None:
    """Ten pushes without noise tell centre of mass and moment arm, so that errors of other pushes halve."""
    pushes = box_pushes(40)
    learner = FittedMechanics()
    asked = pushes.rows(np.arange(10, 40))
    before, after = (np.abs(learner(pushes.rows(np.arange(k)), asked).mean - asked.outcomes).mean() for k in (0, 10))
    assert after < 0.5 * before


def test_frames_of_the_meta_learner_are_turned_back() -> None:
    """Outcomes about another origin return to the caller's frame unchanged."""
    pushes, origin = box_pushes(5), np.array([0.3, -0.1])
    there = _centred(pushes, origin)
    assert there.pushers[:, :2] == pytest.approx(pushes.pushers[:, :2] - origin)
    assert _from_centre(there.outcomes, origin) == pytest.approx(pushes.outcomes)
    assert there.outcomes[:, 2] == pytest.approx(pushes.outcomes[:, 2])


def test_simulated_objects_have_their_weight_far_off() -> None:
    """The centre of mass is inside of the outline, and half a size or more from the centroid."""
    for group in loaded_groups(3, "even", 0):
        outline, centre = group.pushes.outline, np.array(group.centre_of_mass_m)
        assert outline.contains(centre[None])[0]
        assert 0.49 < np.hypot(*(centre - outline.centroid_m)) / outline.size_m < 0.81


def test_a_group_has_pushes_enough() -> None:
    """Fewer than 100 pushes of an object on a surface are no group."""
    assert [group.name for group in groups_of(table(box_pushes(FEWEST)))] == ["box, table"]
    assert groups_of(table(box_pushes(FEWEST - 1))) == []


def test_the_page_has_the_figures(
    tmp_path: Path, project_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command writes page, plot and figures, and three pushes of a loaded box are better than none."""
    monkeypatch.setattr(refine, "COUNTS", (0, 3))
    monkeypatch.setattr(refine, "FEW_COUNTS", (0, 3))
    write_table(tmp_path / "table", table(box_pushes(FEWEST)))
    out = tmp_path / "page"
    models = ["--models-folder", str(project_root / "models")]
    refine.main([str(tmp_path / "table"), "--out", str(out), "--repeats", "1", "--objects", "1", *models])
    figures = json.loads((out / "figures.json").read_text())
    before, after = (figures["learners"][refine.REFINED][k] for k in ("0", "3"))
    assert after["yaw_deg"] < before["yaw_deg"]
    page = (out / "README.md").read_text()
    assert f"| 3 | {after['position_mm']:.2f}, {after['yaw_deg']:.2f} |" in page
    assert (out / "errors.png").stat().st_size > 1000
    assert "wrote" in capsys.readouterr().out


def test_a_table_without_enough_pushes_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command says how many pushes are needed."""
    write_table(tmp_path / "table", table(box_pushes(20)))
    with pytest.raises(SystemExit, match="100 pushes"):
        refine.main([str(tmp_path / "table")])
    with pytest.raises(SystemExit):
        refine.main([str(tmp_path / "table"), "--repeats", "0"])
    assert "positive" in capsys.readouterr().err
