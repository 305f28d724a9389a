"""Recipe steps from the paper's training to that of the served models, with their figures at equal epochs.

    python -m benchmarks.recipe_steps [--epochs 150] [--data data/simulated/abs] [--out runs/recipe-steps] [STEP ...]

Each step adds to the one before it. A row has the figures on the held-out objects, and those of the gates that a
version must pass before an alias may name it (service/pushing/gates.py). Each step is published into its own registry.
An interrupted run continues where it stopped.
"""

import argparse
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import torch

from service.model.predictor import OnnxPredictor
from service.pushing.gates import PUSHING
from service.registry.loading import load_version
from service.registry.promotion import judge
from service.registry.registry import Registry
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe, read_recipe
from training.fitting.run_folder import Network
from training.fitting.samples import TrainingData, read_pushes
from training.fitting.training_loop import fit
from training.publishing.publish import publish

STEPS: Final[dict[str, dict[str, Any]]] = {
    "paper": {},
    "turns-and-mirror": {"symmetries": True},
    "circular-angle": {"angle": "circular"},
    "no-contact": {"no_contact": 0.1, "least_std": 0.02},
    "cooling": {"cooling_epochs": 0.5},  # a share of the epochs
    "16-objects": {"batch_objects": 16},
    "8-objects": {"batch_objects": 8},
    "no-regulariser": {"method": "FCN + CM"},
}


def recipes(epochs: int) -> dict[str, Recipe]:
    """Return the recipe of each step, for this number of epochs."""
    fields = dict(zip(STEPS, accumulate(STEPS.values(), lambda before, step: before | step), strict=True))
    return {
        step: replace(
            read_recipe("paper"),
            epochs=epochs,
            **{**changes, "cooling_epochs": int(epochs * changes.get("cooling_epochs", 0.0))},
        )
        for step, changes in fields.items()
    }


def gate_figures(recipe: Recipe, network: Network, data: Path) -> str:
    """Return figure and limit of each gate of physics, with a mark for refusals."""
    with TemporaryDirectory() as folder:
        registry = Registry(Path(folder) / "models")
        made = publish(recipe, network, read_pushes(data, recipe.context_kind), registry)
        verdicts = judge(load_version(registry, OnnxPredictor, made.name, made.version), None, PUSHING)
    return " | ".join(f"{found.figure:.3f} of {found.limit:.3f}{'' if found.passed else ' ✗'}" for found in verdicts)


def main() -> None:
    """Train and print the steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("steps", nargs="*", metavar="STEP", help=f"of {', '.join(STEPS)}; all unless named")
    parser.add_argument("--epochs", type=int, default=150)
    parser.add_argument("--data", type=Path, default=Path("data/simulated/abs"))
    parser.add_argument("--out", type=Path, default=Path("runs/recipe-steps"))
    options = parser.parse_args()
    if unknown := set(options.steps) - set(STEPS):
        parser.error(f"no such step: {', '.join(sorted(unknown))}")
    torch.set_num_threads(1)
    print("| step | RMSE | STD | NLL | 50 % | 90 % | 95 % | no-contact | turned | angle-at-pi |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for step, recipe in recipes(options.epochs).items():
        if options.steps and step not in options.steps:
            continue
        data = TrainingData.of(recipe.split(), recipe.context_kind, read_pushes(options.data, recipe.context_kind))
        network = fit(recipe, data, options.out / f"{step}-{options.epochs}")
        found = evaluate(network, data.held_out)
        coverage = " | ".join(f"{100 * share:.1f}" for share in found.coverage.values())
        figures = f"{found.rmse:.4f} | {found.std:.4f} | {found.nll:.2f} | {coverage}"
        print(f"| {step} | {figures} | {gate_figures(recipe, network, options.data)} |", flush=True)


if __name__ == "__main__":
    main()
