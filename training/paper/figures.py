"""Raw figures of a reproduction: written as JSON, and read back so that known runs are not trained again."""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch

import service
from service.errors import DataError
from service.files import read_text
from training.fitting.evaluation import Evaluation
from training.paper.experiments import Cell, Experiment
from training.paper.reproduction import Result

FIGURES_FILE: Final = "figures.json"
_LARGEST_FIGURES: Final = 64 << 20  # bytes


def raw_figures(experiment: Experiment, command: str, seeds: int, epochs: int, results: Sequence[Result]) -> str:
    """Render every figure of every run as JSON, with the command, code and machine that made them."""
    document: dict[str, Any] = {
        "experiment": experiment.name,
        "command": command,
        "seeds": seeds,
        "epochs": epochs,
        "cooling_epochs": experiment.cooling_epochs,
        "code_version": service.__version__,
        "torch": torch.__version__,
        "machine": platform.machine(),
        "runs": [asdict(result) for result in results],
    }
    return json.dumps(document, indent=2) + "\n"


def read_figures(path: Path, experiment: Experiment, epochs: int) -> dict[tuple[Cell, int], Result]:
    """Read the results of an earlier reproduction of this experiment, by cell and seed.

    Raises:
        DataError: the file holds no figures, or those of another experiment, number of epochs, cooling or code version.
    """
    try:
        document = json.loads(read_text(path, _LARGEST_FIGURES))
        found = (
            *(document[key] for key in ("experiment", "epochs", "code_version")),
            document.get("cooling_epochs", 0),
        )
        results = [_result(run) for run in document["runs"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DataError(f"{path} holds no figures of a reproduction; give a {FIGURES_FILE} that one wrote") from error
    wanted = (experiment.name, epochs, service.__version__, experiment.cooling_epochs)
    if found != wanted:
        words = "{}, {} epochs, code {}, cooled over {} epochs".format
        raise DataError(f"{path} holds {words(*found)}; wanted is {words(*wanted)}")
    return {(result.cell, result.seed): result for result in results}


def _result(run: Mapping[str, Any]) -> Result:
    leaked = run["leaked"]
    return Result(
        Cell(**run["cell"]),
        int(run["seed"]),
        _evaluation(run["found"]),
        None if leaked is None else _evaluation(leaked),
        dict(run["cost"]),
        dict(run["origin"]),
    )


def _evaluation(found: Mapping[str, Any]) -> Evaluation:
    coverage = {float(level): share for level, share in found["coverage"].items()}
    return Evaluation(**{**found, "coverage": coverage, "sharpness": tuple(found["sharpness"])})
