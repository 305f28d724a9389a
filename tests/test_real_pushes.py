"""Measuring stick: its measures, its predictions in any frame, and its page, on tables made here."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import shapely

from benchmarks.push_measures import LEVELS, REGION_LIMITS, mean_of, repeats, score
from benchmarks.push_predictions import Predicted, doubts, predicted_by_models, quasi_static, view
from benchmarks.real_pushes import main
from service.pushing.contexts import ObjectContext
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.registry.registry import Registry
from tests.served_graphs import publish_shapes
from training.fitting.evaluation import measure
from training.omnipush.published import published_normalisation
from training.simulation.drawing import top_down_view
from training.simulation.solids import solid
from training.tables.push_table import PushTable, TableObject
from training.tables.writing import write_table

BOX = np.array([[0.05, 0.03], [-0.05, 0.03], [-0.05, -0.03], [0.05, -0.03]])
TRIANGLE = np.array([[0.045, 0.045], [-0.0809, 0.045], [0.045, -0.08087]])
TIP_M = 0.00475


def pushers(outline: Outline, count: int) -> DoubleArray:
    """Return pushes (count, 4) of 50 mm from around an outline towards it."""
    rng = np.random.default_rng(1)
    bearing = rng.uniform(-math.pi, math.pi, count)
    direction = np.column_stack([np.cos(bearing), np.sin(bearing)])
    start = outline.centroid_m + 0.075 * direction
    return np.column_stack([start, bearing + math.pi + rng.uniform(-0.4, 0.4, count), np.full(count, 0.05)])


def table(
    count: int, corners: tuple[DoubleArray, ...] = (BOX, TRIANGLE), surfaces: tuple[str, ...] = ("table", "desk")
) -> PushTable:
    """Return a table whose outcomes are those of mechanics, and whose peer is off by 3 mm, 4 mm and 0.1 rad."""
    objects = tuple(TableObject(f"object {number}", Outline.of(part)) for number, part in enumerate(corners))
    index = np.arange(count) % len(objects)
    rows = np.array([pushers(item.outline, count) for item in objects])[index, np.arange(count)]
    found = PushTable(
        objects=objects,
        object_index=index,
        pushers=rows,
        outcomes=np.zeros((count, 3)),
        pusher_radius_m=np.full(count, TIP_M),
        surfaces=surfaces,
        surface_index=np.arange(count) // 2 % len(surfaces),
        source="made for a test",
        digest="0" * 64,
    )
    outcomes = quasi_static(found)
    return PushTable(
        **{**vars(found), "outcomes": outcomes, "peers": {"rival": outcomes + np.array([0.003, 0.004, 0.1])}}
    )


def run(folder: Path, *options: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Run the command on a table and return the text that it prints."""
    main([str(folder), *options])
    return capsys.readouterr().out


def test_the_page_has_every_model_per_object_and_surface(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Mechanics is exact on its own outcomes, a peer is off by a known error, and a published model has a spread."""
    write_table(tmp_path / "table", table(60))
    out = tmp_path / "page"
    text = run(tmp_path / "table", "--out", str(out), "--source", "a rig of ours", capsys=capsys)
    assert "| rival | a peer's column of the table | 60 | 5.00 (5.00) [5.00, 5.00] | 5.73 (5.73)" in text
    assert "push-indicator is not asked" in text
    figures = json.loads((out / "figures.json").read_text())
    scores = {model["name"]: model["scores"] for model in figures["models"]}
    assert {"nothing moves", "mechanics", "simulation", "rival", "push-none@1", "push-visual@1"} <= set(scores)
    assert scores["mechanics"]["all"]["position_mm"]["mean"] < 1e-6
    assert scores["nothing moves"]["all"]["position_mm"]["mean"] > 10.0
    assert 0.5 < scores["simulation"]["all"]["position_mm"]["mean"] < 5.0
    assert scores["push-visual@1"]["all"]["calibration"]["intervals"][1] > 0.0
    groups = {f"object {number}, {surface}" for number in (0, 1) for surface in ("table", "desk")}
    assert set(scores["mechanics"]) == {"all", *groups}
    assert sum(scores["mechanics"][group]["pushes"] for group in groups) == 60
    page = (out / "README.md").read_text()
    assert page.count("| object 0, desk | 15 |") == len(scores)
    assert "Origin: a rig of ours." in page
    assert str(tmp_path) not in page
    assert (out / "errors.png").read_bytes().startswith(b"\x89PNG")
    before = page, (out / "figures.json").read_bytes()
    run(tmp_path / "table", "--out", str(out), "--source", "a rig of ours", capsys=capsys)
    assert before == ((out / "README.md").read_text(), (out / "figures.json").read_bytes())


def test_twenty_pushes_of_one_box_say_how_little_they_tell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A short table is scored, with a sentence on the interval of the mean and on the next step."""
    write_table(tmp_path, table(20, (BOX,), ("table",)), "csv")
    text = run(tmp_path, "--models", "rival", "mechanics", capsys=capsys)
    assert "20 pushes are few" in text
    assert "within 22 points" in text
    assert text.splitlines()[-1].startswith("next: --out")
    assert "push-visual" not in text


def test_pushes_that_a_model_does_not_know_are_left_out_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Omnipush's models are asked for pushes of 50 mm only, and the page says how many others there are."""
    found = table(40)
    found.pushers[:10, 3] = 0.08
    write_table(tmp_path, found)
    text = run(tmp_path, "--models", "push-none@1", "push-visual", capsys=capsys)
    assert "push-none@1: 10 pushes are left out" in text
    assert "| push-visual@1 | a view drawn from the outline | 30 |" in text
    assert "mechanics" not in text


def test_a_model_of_any_shape_is_asked_for_pushes_of_any_length(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Outlines, lengths and tips are sent as they are, and only a push that starts inside is left out."""
    publish_shapes(Registry(tmp_path / "models"))
    found = table(40, (BOX, 1.2 * BOX))
    found.pushers[:20, 3] = np.linspace(0.03, 0.09, 20)
    found.pusher_radius_m[::3] = 0.008
    found.pushers[7, :2] = 0.0
    write_table(tmp_path / "table", found)
    options = ["--models-folder", str(tmp_path / "models"), "--models", "push-shape", "--out", str(tmp_path / "page")]
    text = run(tmp_path / "table", *options, capsys=capsys)
    assert "| push-shape@1 | outline; centre of mass, friction and tip where the table has them | 39 |" in text
    assert "push-shape@1: 1 of 40 pushes are left out: they start inside of their object." in text
    page = (tmp_path / "page" / "README.md").read_text()
    assert re.search(r"push-shape@1 is worst on object \d, \w+: .* hold least on object \d, \w+: \d+ %\.", page)


def test_a_quick_look_takes_some_objects_and_pushes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Objects are chosen by name, and pushes with a fixed seed."""
    write_table(tmp_path, table(60))
    text = run(tmp_path, "--models", "mechanics", "--shapes", "object 1", "--limit", "7", capsys=capsys)
    assert "| mechanics | outline | 7 |" in text


def test_an_outline_that_does_not_fit_the_pushes_is_doubted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Objects that moved although no tip met their outline are counted, with the command that tells more."""
    found = table(40, (BOX,))
    assert doubts(found) == []
    found.pushers[:10, :2] += 1.0
    write_table(tmp_path, found)
    text = run(tmp_path, "--models", "mechanics", capsys=capsys)
    assert "10 of 40 pushes never meet the outline" in text
    assert "cazsl-train data check" in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["missing"], "missing"),
        (["table", "--shapes", "cup"], "no object 'cup'; it has object 0"),
        (["table", "--models", "mechanics", "push-cup"], "--models: there is no push-cup"),
        (["table", "--models", "push-indicator"], "push-indicator is not asked"),
        (["table", "--models-folder", "missing"], "missing"),
        (["table", "--out", "table/objects.parquet"], "name a folder to write into"),
    ],
    ids=["no table", "no object", "no model", "no model that fits", "no registry", "a file"],
)
def test_a_mistake_ends_in_one_line(options: list[str], words: str, tmp_path: Path) -> None:
    """A mistake ends the command with one line that says how to go on."""
    write_table(tmp_path / "table", table(4))
    paths = [str(tmp_path / option) if option.startswith(("table", "missing")) else option for option in options]
    with pytest.raises(SystemExit) as caught:
        main(paths)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def answered(found: PushTable, root: Path, name: str) -> Predicted:
    """Return the predictions of one published version."""
    (one,) = predicted_by_models(found, root / "models", lambda wanted: wanted == name, [])
    return one


def test_a_prediction_does_not_depend_on_the_origin_of_the_outline(project_root: Path) -> None:
    """An object drawn about another origin has the same motion, and a spread of the same volume, in its own frame."""
    shift = np.array([0.03, -0.02])
    found = table(30, (BOX,))
    moved = table(30, (BOX + shift,))
    plain, shifted = (answered(one, project_root, "push-visual@1") for one in (found, moved))
    cos, sin = np.cos(plain.mean[:, 2]), np.sin(plain.mean[:, 2])
    swung = np.column_stack([cos * shift[0] - sin * shift[1], sin * shift[0] + cos * shift[1]])
    assert shifted.mean[:, 2] == pytest.approx(plain.mean[:, 2], abs=1e-5)
    assert shifted.mean[:, :2] == pytest.approx(plain.mean[:, :2] + shift - swung, abs=1e-6)
    assert plain.covariance is not None
    assert shifted.covariance is not None
    step = 1e-6  # the covariance is that of a small turn of the frame about the shifted origin
    lever = (
        swung
        - np.column_stack(
            [np.cos(step) * swung[:, 0] - step * swung[:, 1], step * swung[:, 0] + np.cos(step) * swung[:, 1]]
        )
    ) / step
    turn = plain.covariance[:, 2, 2]
    assert shifted.covariance[:, 0, 2] == pytest.approx(lever[:, 0] * turn, rel=1e-2, abs=1e-9)
    assert shifted.covariance[:, 1, 2] == pytest.approx(lever[:, 1] * turn, rel=1e-2, abs=1e-9)
    assert np.linalg.det(shifted.covariance) == pytest.approx(np.linalg.det(plain.covariance), rel=1e-3)


def test_an_outline_is_drawn_as_the_views_of_training_are() -> None:
    """The view of an Omnipush object's outline is that of its pieces, but for the seams between them."""
    for descriptor in ("4a4a4a4a", "1a2a3a4a"):
        context = ObjectContext.from_descriptor(descriptor)
        pieces = [shapely.Polygon(piece).buffer(1e-6, join_style="mitre") for piece in solid(context).pieces]
        outline = Outline.of(shapely.get_coordinates(shapely.union_all(pieces))[:-1])
        drawn = view(Outline.of(outline.corners - outline.centroid_m)).astype(int)
        shift = np.rint(outline.centroid_m / 0.160 * 481).astype(int)
        theirs = np.roll(top_down_view(context).astype(int), (shift[1], -shift[0]), axis=(0, 1))
        assert (np.abs(drawn - theirs) > 64).mean() < 0.002
        assert drawn.max() == theirs.max() == 128


def test_honest_gaussians_are_covered_as_they_say() -> None:
    """Outcomes drawn from correlated Gaussians lie in their intervals and regions as often as promised."""
    rng = np.random.default_rng(2)
    root = np.array([[0.003, 0.0, 0.0], [0.002, 0.001, 0.0], [0.05, -0.02, 0.03]])
    mean = rng.uniform(-0.02, 0.02, (20_000, 3))
    outcomes = mean + rng.standard_normal((20_000, 3)) @ root.T
    found = score(outcomes, mean, np.tile(root @ root.T, (20_000, 1, 1)))
    assert found.calibration is not None
    assert found.calibration.intervals == pytest.approx(LEVELS, abs=0.01)
    assert found.calibration.regions == pytest.approx(LEVELS, abs=0.01)


def test_region_limits_are_quantiles_of_chi_square() -> None:
    """The distribution of chi-square with 3 degrees of freedom has the levels at the limits."""
    for level, limit in zip(LEVELS, REGION_LIMITS, strict=True):
        share = math.erf(math.sqrt(limit / 2.0)) - math.sqrt(2.0 * limit / math.pi) * math.exp(-limit / 2.0)
        assert share == pytest.approx(level, abs=1e-7)


def test_rmse_nll_and_intervals_are_those_of_the_trainer() -> None:
    """For independent coordinates the measures are those with which the trainer evaluates its networks."""
    rng = np.random.default_rng(3)
    unit = published_normalisation().output_std
    outcomes, mean, std = (
        rng.normal(0, unit, (50, 3)),
        rng.normal(0, unit, (50, 3)),
        rng.uniform(0.1, 1.0, (50, 3)) * unit,
    )
    found = score(outcomes, mean, np.einsum("ni,ij->nij", std**2, np.eye(3)))
    theirs = measure(
        (mean / unit).astype(np.float32),
        np.log(std / unit).astype(np.float32),
        (outcomes / unit).astype(np.float32),
        (1.0,),
    )
    assert found.calibration is not None
    assert found.rmse == pytest.approx(theirs.rmse, rel=1e-5)
    assert found.calibration.nll == pytest.approx(theirs.nll, rel=1e-4)
    assert found.calibration.intervals == pytest.approx(tuple(theirs.coverage.values()), abs=0.01)


def test_an_error_of_yaw_is_the_shorter_turn() -> None:
    """A yaw just below pi and one just above -pi are near each other."""
    found = score(np.array([[0.003, 0.004, 3.1]]), np.array([[0.0, 0.0, -3.1]]), None)
    assert found.position_mm.mean == pytest.approx(5.0)
    assert found.yaw_deg.mean == pytest.approx(math.degrees(2.0 * math.pi - 6.2))
    assert found.calibration is None


@pytest.mark.parametrize("count", [40, 6000], ids=["bootstrap", "normal"])
def test_the_interval_of_a_mean_is_two_standard_errors_wide(count: int) -> None:
    """Bootstrap and normal interval have the width of 1.96 standard errors to each side."""
    values = np.random.default_rng(4).exponential(3.0, count)
    found = mean_of(values)
    assert found.low < found.mean < found.high
    assert (found.high - found.low) / 2.0 == pytest.approx(1.96 * values.std() / math.sqrt(count), rel=0.1)


def test_repeats_are_pairs_of_one_object_from_the_same_start() -> None:
    """Pushes pair up within an object, within a millimetre and a degree, even where the angle passes pi."""
    start = [-0.08, 0.0, math.pi - 0.001, 0.05]
    rows = np.array([start, [-0.0805, 0.0, -math.pi + 0.001, 0.05], start, [-0.09, 0.0, math.pi, 0.05], start])
    found = PushTable(
        **{
            **vars(table(5, surfaces=("table", "desk"))),
            "object_index": np.array([0, 0, 0, 0, 1]),
            "surface_index": np.array([0, 0, 1, 0, 0]),
            "pushers": rows,
            "outcomes": np.array([[0.0, 0.0, 0.0], [0.003, 0.004, 0.1], [0.0, 0.01, 0.0], [1, 1, 1], [1, 1, 1]]),
            "peers": {},
        }
    )
    on_one, on_two = repeats(found)
    assert on_one is not None
    assert on_two is not None
    assert (on_one.pairs, on_two.pairs) == (1, 2)
    assert on_one.position_mm.mean == pytest.approx(5.0)
    assert on_one.yaw_deg.mean == pytest.approx(math.degrees(0.1))
    assert on_two.position_mm.mean == pytest.approx((10.0 + math.hypot(3.0, 6.0)) / 2.0)
