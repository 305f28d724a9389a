"""Raw figures: write_figures as JSON, read back unchanged, and refused if they are of another reproduction."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from service.errors import DataError
from training.fitting.evaluation import Evaluation
from training.paper.experiments import Cell, experiments
from training.paper.figures import raw_figures, read_figures
from training.paper.reproduction import Result

FOUND = Evaluation(0.2, 0.1, 4.384, -1.5, {0.5: 0.4, 0.9: 0.75, 0.95: 0.8}, (0.001, 0.002, 0.03))
EXPERIMENT = experiments()["different-objects"]
RESULTS = [
    Result(
        Cell("different-objects", method, "none"),
        seed,
        FOUND,
        FOUND if method == "ANP" else None,
        {"seconds": 5.5, "device": "cpu", "precision": "bfloat16"},
        {"source": "made up by a test", "sha256": "0" * 64},
    )
    for method in ("ANP", "FCN")
    for seed in (0, 1)
]


def write_figures(folder: Path, change: Callable[[dict[str, Any]], object] = lambda document: None) -> Path:
    """Write the figures of the results, with one change."""
    document = json.loads(raw_figures(EXPERIMENT, "cazsl-train reproduce", 2, 300, RESULTS))
    change(document)
    path = folder / "figures.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def test_figures_are_read_as_they_were_written(tmp_path: Path) -> None:
    """Figures are read back for every run by cell and seed, to the last digit."""
    found = read_figures(write_figures(tmp_path), EXPERIMENT, 300)

    assert list(found.values()) == RESULTS
    assert list(found) == [(result.cell, result.seed) for result in RESULTS]


def test_figures_without_cooling_have_a_constant_rate(tmp_path: Path) -> None:
    """Figures without ``cooling_epochs``, from before that option, are of a constant learning rate."""
    path = write_figures(tmp_path, lambda document: document.pop("cooling_epochs"))

    assert list(read_figures(path, EXPERIMENT, 300).values()) == RESULTS
    with pytest.raises(DataError, match=r"wanted is different-objects, 300 epochs, code .*, cooled over 10 epochs"):
        read_figures(path, replace(EXPERIMENT, cooling_epochs=10), 300)


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document.update(experiment="different-surfaces"),
        lambda document: document.update(epochs=3000),
        lambda document: document.update(code_version="0.0.9"),
        lambda document: document.update(cooling_epochs=10),
    ],
    ids=["experiment", "epochs", "code", "cooling"],
)
def test_figures_of_another_reproduction_are_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    """Figures of another experiment, code version or number of epochs are refused, and the message names both."""
    with pytest.raises(DataError, match=r"holds .* epochs, code .*; wanted is different-objects, 300 epochs, code"):
        read_figures(write_figures(tmp_path, change), EXPERIMENT, 300)


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document.pop("runs"),
        lambda document: document.update(runs=[{}]),
        lambda document: document.update(runs=7),
        lambda document: document["runs"][0]["found"].update(more=1),
        lambda document: document["runs"][0].update(cell=None),
    ],
    ids=["no runs", "an empty run", "a number", "a figure too many", "no cell"],
)
def test_a_file_without_figures_is_refused(tmp_path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """A file that holds no figures is refused by its name."""
    with pytest.raises(DataError, match=r"figures\.json holds no figures of a reproduction"):
        read_figures(write_figures(tmp_path, change), EXPERIMENT, 300)
