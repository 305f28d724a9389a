"""Goals: figures are found in the results of the benchmarks, or copied by hand, and judged by their limits."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.goals import goals, main, measured, page

RECORDED: dict[str, Any] = {
    "models": [
        {"name": "mechanics", "scores": {}},
        *(
            {
                "name": f"push-shape@{version}",
                "scores": {
                    name: {
                        "position_mm": {"mean": error_mm},
                        "yaw_deg": {"mean": 4.5},
                        "calibration": {"regions": [0.5, share, 0.95]},
                    }
                    for name, share in (("all", 0.9), ("rect2, abs", 0.79), ("hex, abs", 0.92))
                },
            }
            for version, error_mm in ((9, 3.9), (10, 3.5))
        ),
    ]
}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Return a folder of results with those on recorded pushes."""
    (tmp_path / "real-pushes").mkdir()
    (tmp_path / "real-pushes" / "figures.json").write_text(json.dumps(RECORDED))
    return tmp_path


def test_figures_are_those_of_the_last_version_and_judged(results: Path) -> None:
    """Version 10 is later than 9. Its error is within the limit, its yaw and its worst region are not."""
    text = page(results, {})
    assert "position error at most 3.6 mm | 3.5 mm | reached |" in text
    assert "yaw error at most 4.4 degrees | 4.5 degrees | **missed** |" in text
    assert "worst shape and surface | 79 % | **missed** |" in text
    assert "2 of" in text
    assert "2 are missed" in text


def test_a_figure_that_no_file_has_is_taken_from_the_figures_by_hand(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Results of a command are preferred to figures by hand, and goals without either are listed as open."""
    out = results / "any-object"
    out.mkdir()
    (out / "measured.json").write_text(json.dumps({"single": 2.1, "recorded_mm": 99.0}))
    main(["--results", str(results), "--out", str(out)])
    text = (out / "goals.md").read_text()
    assert "at least 2.0 times the empty endpoint | 2.1 | reached |" in text
    assert "99" not in text
    assert "not measured" in text
    assert "goals.md" in capsys.readouterr().out


def test_a_result_without_the_figure_counts_as_not_measured(results: Path) -> None:
    """A run on other models, or without held-out families, has no figure, and is no fault."""
    (results / "real-pushes" / "figures.json").write_text(json.dumps({"models": [{"name": "mechanics"}]}))
    listed = [goal for section in goals().values() for goal in section]
    assert all(measured(goal, results, {}) is None for goal in listed)
    assert len({goal.key for goal in listed}) == len(listed)


def test_a_broken_result_names_its_file(results: Path) -> None:
    """A file that is no JSON ends the command with one line."""
    (results / "real-pushes" / "figures.json").write_text("{")
    with pytest.raises(SystemExit, match=r"real-pushes.figures.json is no JSON"):
        main(["--results", str(results), "--out", str(results)])
