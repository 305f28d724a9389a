"""Small training runs for tests: train them, interrupt them, read their files."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from training.fitting.recipe import Recipe
from training.fitting.run_folder import CHECKPOINT_FILE, CONFIG_FILE, METRICS_FILE, WEIGHTS_FILE, Network
from training.fitting.samples import TrainingData
from training.fitting.training_loop import fit
from training.omnipush.pushes import Pushes


def train_run(recipe: Recipe, pushes: Pushes, run: Path) -> Network:
    """Fit a recipe to these pushes."""
    return fit(recipe, TrainingData.of(recipe.split(), recipe.context_kind, pushes), run, quiet=True)


def interrupt_run(run: Path, recipe: Recipe, epochs: int, pushes: Pushes, scratch: Path) -> Path:
    """Make the folder of a run of ``recipe`` that was killed right after its checkpoint at this epoch.

    The first epochs of a run do not depend on how many follow, so a finished shorter run has the very same checkpoint.
    """
    train_run(replace(recipe, epochs=epochs), pushes, scratch)
    run.mkdir()
    for name in (CHECKPOINT_FILE, METRICS_FILE):
        shutil.copy(scratch / name, run / name)
    config = json.loads((scratch / CONFIG_FILE).read_text(encoding="utf-8"))
    config["recipe"] = recipe.record()
    (run / CONFIG_FILE).write_text(json.dumps(config, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return run


def read_metrics(run: Path) -> list[dict[str, Any]]:
    """Read every line of a run's metrics."""
    return [json.loads(line) for line in (run / METRICS_FILE).read_text(encoding="utf-8").splitlines()]


def read_weights(run: Path) -> bytes:
    """Read the file of a run's weights."""
    return (run / WEIGHTS_FILE).read_bytes()
