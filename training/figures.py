"""The raw figures of a reproduction as JSON, and back: what was trained in another place or week need not be again."""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch

import service
from service.errors import DataError
from training.evaluate import Evaluation
from training.experiments import Cell
from training.reproduction import Result

FIGURES_FILE: Final = "figures.json"


def raw_figures(experiment: str, command: str, seeds: int, epochs: int, results: Sequence[Result]) -> str:
    """Every figure of every run as JSON, with what made it."""
    document: dict[str, Any] = {
        "experiment": experiment,
        "command": command,
        "seeds": seeds,
        "epochs": epochs,
        "code_version": service.__version__,
        "torch": torch.__version__,
        "machine": platform.machine(),
        "runs": [asdict(result) for result in results],
    }
    return json.dumps(document, indent=2) + "\n"


def read_figures(path: Path, experiment: str, epochs: int) -> dict[tuple[Cell, int], Result]:
    """The runs of an earlier reproduction of this experiment, by cell and seed.

    Raises:
        DataError: it is none, or of another experiment, another number of epochs or another version of the code.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        found = tuple(document[key] for key in ("experiment", "epochs", "code_version"))
        results = [_result(run) for run in document["runs"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DataError(f"{path} holds no figures of a reproduction; name a {FIGURES_FILE} that one wrote") from error
    wanted = (experiment, epochs, service.__version__)
    if found != wanted:
        raise DataError(
            f"{path} holds {found[0]}, {found[1]} epochs, code {found[2]}; "
            f"wanted is {wanted[0]}, {wanted[1]} epochs, code {wanted[2]}"
        )
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
