"""The folder of a training run: its files, and how each is written and read.

- ``config.json``: recipe, origin of the data, version of the code. Written first.
- ``metrics.jsonl``: one line per epoch.
- ``checkpoint.pt``: network, optimiser, next epoch and time spent. Renewed while the run trains.
- ``cost.json`` and ``weights.safetensors``: written when the run ends.

The metrics grow line by line. Every other file is replaced as a whole, so neither a reader nor a crash meets a part.
"""

import io
import json
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as render_safetensors
from torch import Tensor

import service
from service.errors import DataError
from service.files import check_regular, read_text
from service.storage.disk import replace_whole
from training.fitting.recipe import Recipe, parse_recipe_record
from training.fitting.samples import TrainingData
from training.networks.angles import PushForm
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PUSH_SHAPES, PushNetwork, Shape

CONFIG_FILE: Final = "config.json"
METRICS_FILE: Final = "metrics.jsonl"
CHECKPOINT_FILE: Final = "checkpoint.pt"
WEIGHTS_FILE: Final = "weights.safetensors"
COST_FILE: Final = "cost.json"
Network = PushNetwork | NeuralProcess


class TimeSpent(NamedTuple):
    """Time spent on a run, summed over its interruptions."""

    seconds: float  # by the clock, including pauses and other programs on the machine
    processor_s: float  # of all threads of the process

    @classmethod
    def now(cls) -> "TimeSpent":
        """Read both clocks. Only the difference of two readings has a meaning."""
        return cls(time.monotonic(), time.process_time())

    def since(self, started: "TimeSpent", before: "TimeSpent") -> "TimeSpent":
        """Return the time from ``started`` to this reading, added to ``before``."""
        return TimeSpent(*(old + new - at for old, new, at in zip(before, self, started, strict=True)))


def build_network(recipe: Recipe, shape: Shape) -> Network:
    """Build a recipe's network with fresh weights, drawn from torch's generator."""
    method = recipe.network()
    if method.neural_process:
        return NeuralProcess(shape.inputs, shape.outputs, PushForm(recipe.angle), recipe.least_std)
    return PushNetwork(method, shape, PushForm(recipe.angle), recipe.least_std, recipe.encoder_channels)


def load_run(folder: Path) -> tuple[Recipe, Network, dict[str, Any]]:
    """Load a finished run: its recipe, its fitted network and the recorded origin of its data.

    Raises:
        DataError: the run is missing or not finished.
    """
    try:
        config = json.loads(read_text(folder / CONFIG_FILE))
        check_regular(folder / WEIGHTS_FILE, (folder / WEIGHTS_FILE).stat().st_mode)
        record, origin = dict(config["recipe"]), dict(config["data"])
        weights: dict[str, Tensor] = load_file(folder / WEIGHTS_FILE)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, SafetensorError) as error:
        raise DataError(
            f"{folder} is not a finished run; finish it with: cazsl-train fit RECIPE --run {folder}"
        ) from error
    recipe = parse_recipe_record(record, str(folder / CONFIG_FILE))
    network = build_network(recipe, PUSH_SHAPES[recipe.context_kind])
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        raise DataError(f"{folder / WEIGHTS_FILE} holds the weights of another network; fit the run again") from error
    return recipe, network.eval(), origin


def open_run(folder: Path, recipe: Recipe, data: TrainingData) -> None:
    """Create the folder and record the run, or check that the folder records the same run.

    Raises:
        DataError: the folder records another recipe, other data or another version of the code.
    """
    folder.mkdir(parents=True, exist_ok=True)
    config = {
        "recipe": recipe.record(),
        "data": data.origin,
        "code_version": service.__version__,
    }
    text = json.dumps(config, indent=2, sort_keys=True) + "\n"
    path = folder / CONFIG_FILE
    if not path.exists():
        replace_whole(path, text.encode())
    elif read_text(path) != text:
        raise DataError(f"{path} records another run (recipe, data or code version); choose another --run or remove it")


def save_checkpoint(
    folder: Path, network: Network, adam: torch.optim.Optimizer, next_epoch: int, spent: TimeSpent
) -> None:
    """Write the state from which ``resume`` continues with ``next_epoch``."""
    state = {"network": network.state_dict(), "adam": adam.state_dict(), "next_epoch": next_epoch, **spent._asdict()}
    content = io.BytesIO()
    torch.save(state, content)
    replace_whole(folder / CHECKPOINT_FILE, content.getvalue())


def resume(folder: Path, network: Network, adam: torch.optim.Optimizer) -> tuple[int, TimeSpent]:
    """Load the last checkpoint and drop metrics logged after it. Return the next epoch and the time spent so far."""
    path, metrics = folder / CHECKPOINT_FILE, folder / METRICS_FILE
    next_epoch, spent = 0, TimeSpent(0.0, 0.0)
    if path.is_file():
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
        network.load_state_dict(checkpoint["network"])
        adam.load_state_dict(checkpoint["adam"])
        next_epoch, seconds = int(checkpoint["next_epoch"]), float(checkpoint["seconds"])
        spent = TimeSpent(seconds, float(checkpoint.get("processor_s", seconds)))  # absent from older checkpoints
    if metrics.is_file():
        lines = metrics.read_bytes().splitlines(keepends=True)
        replace_whole(metrics, b"".join(lines[:next_epoch]))
    return next_epoch, spent


def write_cost(folder: Path, cost: dict[str, str | float]) -> None:
    """Write the cost of the training: times, device and precision."""
    replace_whole(folder / COST_FILE, (json.dumps(cost, sort_keys=True) + "\n").encode())


def write_weights(folder: Path, network: Network) -> None:
    """Write the network's weights."""
    weights = {name: value.cpu() for name, value in network.state_dict().items()}
    replace_whole(folder / WEIGHTS_FILE, render_safetensors(weights))
