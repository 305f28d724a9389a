"""The folder of a training run: configuration, metrics, checkpoint, weights, cost."""

import json
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

import service
from service.errors import DataError
from training.fitting.recipe import CIRCULAR, Recipe, parse_recipe_record
from training.fitting.samples import TrainingData
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PUSH_SHAPES, PushNetwork, Shape

CONFIG_FILE: Final = "config.json"
METRICS_FILE: Final = "metrics.jsonl"
CHECKPOINT_FILE: Final = "checkpoint.pt"
WEIGHTS_FILE: Final = "weights.safetensors"
COST_FILE: Final = "cost.json"
Network = PushNetwork | NeuralProcess


class Spent(NamedTuple):
    """What a run took, over all its sittings."""

    seconds: float  # by the clock, pauses and whatever else had the machine included
    processor_s: float  # of all threads of the process

    @classmethod
    def now(cls) -> "Spent":
        """Readings that only differences of mean something."""
        return cls(time.monotonic(), time.process_time())

    def since(self, started: "Spent", before: "Spent") -> "Spent":
        """What passed from ``started`` to this, on top of what came before."""
        return Spent(*(old + new - at for old, new, at in zip(before, self, started, strict=True)))


def build_network(recipe: Recipe, shape: Shape) -> Network:
    """A fresh network of a recipe, from torch's generator."""
    method = recipe.network()
    if method.neural_process:
        return NeuralProcess(shape.inputs, shape.outputs)
    return PushNetwork(method, shape, recipe.angle == CIRCULAR, recipe.least_std)


def load_run(folder: Path) -> tuple[Recipe, Network, dict[str, Any]]:
    """The recipe, the fitted network and the recorded data of a finished run.

    Raises:
        DataError: the run is missing or not finished.
    """
    try:
        config = json.loads((folder / CONFIG_FILE).read_text(encoding="utf-8"))
        weights: dict[str, Tensor] = load_file(folder / WEIGHTS_FILE)
    except (OSError, ValueError, SafetensorError) as error:
        raise DataError(
            f"{folder} is not a finished run; finish it with: cazsl-train fit RECIPE --run {folder}"
        ) from error
    recipe = parse_recipe_record(config["recipe"], str(folder / CONFIG_FILE))
    network = build_network(recipe, PUSH_SHAPES[recipe.context_kind])
    network.load_state_dict(weights)
    return recipe, network.eval(), config["data"]


def _open_run(folder: Path, recipe: Recipe, data: TrainingData) -> None:
    """Write what the run is, or check that the folder holds the same one."""
    folder.mkdir(parents=True, exist_ok=True)
    config = {
        "recipe": recipe.record(),
        "data": data.origin,
        "code_version": service.__version__,
    }
    text = json.dumps(config, indent=2, sort_keys=True) + "\n"
    path = folder / CONFIG_FILE
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise DataError(f"{path} records another run (recipe, data or code version); choose another --run or remove it")
    path.write_text(text, encoding="utf-8")


def _save_checkpoint(
    folder: Path, network: Network, adam: torch.optim.Optimizer, next_epoch: int, spent: Spent
) -> None:
    part = folder / (CHECKPOINT_FILE + ".part")
    state = {"network": network.state_dict(), "adam": adam.state_dict(), "next_epoch": next_epoch, **spent._asdict()}
    torch.save(state, part)
    part.replace(folder / CHECKPOINT_FILE)


def _resume(folder: Path, network: Network, adam: torch.optim.Optimizer) -> tuple[int, Spent]:
    """Load the last checkpoint, drop the metrics written after it; the epoch to go on with, and what it took so far."""
    path, metrics = folder / CHECKPOINT_FILE, folder / METRICS_FILE
    next_epoch, spent = 0, Spent(0.0, 0.0)
    if path.is_file():
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
        network.load_state_dict(checkpoint["network"])
        adam.load_state_dict(checkpoint["adam"])
        next_epoch, seconds = int(checkpoint["next_epoch"]), float(checkpoint["seconds"])
        spent = Spent(seconds, float(checkpoint.get("processor_s", seconds)))  # which older checkpoints do not tell
    if metrics.is_file():
        lines = metrics.read_text(encoding="utf-8").splitlines(keepends=True)
        metrics.write_text("".join(lines[:next_epoch]), encoding="utf-8")
    return next_epoch, spent


def _write_cost(folder: Path, cost: dict[str, str | float]) -> None:
    """Write what the training took."""
    (folder / COST_FILE).write_text(json.dumps(cost, sort_keys=True) + "\n", encoding="utf-8")


def _write_weights(folder: Path, network: Network) -> None:
    part = folder / (WEIGHTS_FILE + ".part")
    save_file({name: value.cpu() for name, value in network.state_dict().items()}, part)
    part.replace(folder / WEIGHTS_FILE)
