"""The training loop: Siamese halves of a batch of objects, Adam, a record of every epoch.

A run folder holds ``config.json`` (recipe, data, code version), ``metrics.jsonl`` (a line per epoch), ``checkpoint.pt``
(while running) and at the end ``weights.safetensors``. Batches depend on the seed and the epoch's number alone, so a
run that was killed continues from its last checkpoint as one that was not: to the same weights on one thread. On
several, two runs of one seed differ by rounding from the first epoch on (1e-6 of the loss) and drift apart with time.
"""

import ctypes
import json
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor
from tqdm import tqdm

import service
from service.errors import DataError
from training.data import Pushes
from training.evaluate import NormalisedPushes, evaluate
from training.losses import gaussian_nll, l2_regulariser
from training.networks import PushNetwork
from training.recipes import Recipe, parse_recipe_record

CONFIG_FILE: Final = "config.json"
METRICS_FILE: Final = "metrics.jsonl"
CHECKPOINT_FILE: Final = "checkpoint.pt"
WEIGHTS_FILE: Final = "weights.safetensors"
CHECKPOINT_EVERY_S: Final = 30.0
HELD_OUT_EVERY_EPOCHS: Final = 25


def fit(recipe: Recipe, pushes: Pushes, folder: Path, quiet: bool = False) -> PushNetwork:
    """Train what the recipe says, or continue where the run folder stopped; the weights of the last epoch.

    Raises:
        DataError: objects are missing, or the folder holds another run.
    """
    keep_freed_memory()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    split = recipe.split()
    train = NormalisedPushes.of(pushes.select(split.train), device)
    held_out = NormalisedPushes.of(pushes.select(split.test), device)

    torch.manual_seed(recipe.seed)
    network = PushNetwork(recipe.network().masked).to(device)
    adam = torch.optim.Adam(network.parameters(), lr=recipe.learning_rate, fused=True)
    _open_run(folder, recipe, pushes)
    first_epoch = _resume(folder, network, adam)

    rmse = float("nan")
    saved_at = time.monotonic()
    epochs = range(first_epoch, recipe.epochs)
    with (
        (folder / METRICS_FILE).open("a", encoding="utf-8") as metrics,
        tqdm(
            epochs, initial=first_epoch, total=recipe.epochs, desc=recipe.method, unit="epoch", disable=quiet
        ) as progress,
    ):
        for epoch in progress:
            likelihood, regulariser = train_epoch(network, adam, train, recipe, epoch)
            last = epoch == recipe.epochs - 1
            line = {"epoch": epoch, "nll": likelihood, "regulariser": regulariser}
            if last or epoch % HELD_OUT_EVERY_EPOCHS == 0:
                rmse = evaluate(network, held_out).rmse
                line["held_out_rmse"] = rmse
            metrics.write(json.dumps(line) + "\n")
            progress.set_postfix(loss=f"{likelihood + regulariser:.3f}", held_out_rmse=f"{rmse:.3f}", refresh=False)
            if last or time.monotonic() - saved_at > CHECKPOINT_EVERY_S:
                metrics.flush()
                _save_checkpoint(folder, network, adam, epoch + 1)
                saved_at = time.monotonic()
    part = folder / (WEIGHTS_FILE + ".part")
    save_file({name: value.cpu() for name, value in network.state_dict().items()}, part)
    part.replace(folder / WEIGHTS_FILE)
    return network


def train_epoch(
    network: PushNetwork, adam: torch.optim.Optimizer, train: NormalisedPushes, recipe: Recipe, epoch: int
) -> tuple[float, float]:
    """One pass over all objects; the mean likelihood and regulariser over its batches."""
    order = np.random.default_rng([recipe.seed, epoch]).permutation(len(train.context))
    sums, batches = torch.zeros(2, device=train.context.device), 0
    for batch in torch.split(torch.from_numpy(order).to(train.context.device), recipe.batch_objects):
        context = train.context[batch]
        mean, log_std, mask = network(train.pusher[batch], context)
        likelihood = gaussian_nll(mean, log_std, train.outcome[batch], train.valid[batch])
        regulariser = likelihood.new_zeros(())
        if recipe.network().regularised and mask is not None:
            regulariser = l2_regulariser(mask, context, recipe.lambda_1, recipe.lambda_2)
        adam.zero_grad()
        torch.autograd.backward(likelihood + regulariser)
        adam.step()
        sums += torch.stack([likelihood.detach(), regulariser.detach()])
        batches += 1
    likelihood_sum, regulariser_sum = (sums / batches).tolist()
    return likelihood_sum, regulariser_sum


def load_run(folder: Path) -> tuple[Recipe, PushNetwork, dict[str, Any]]:
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
    network = PushNetwork(recipe.network().masked)
    network.load_state_dict(weights)
    return recipe, network, config["data"]


def keep_freed_memory() -> None:
    """Ask glibc to reuse the large activations of a step in the next one instead of returning them to the kernel.

    Faulting 16 MB pages in again costs about a tenth of an epoch. Other allocators ignore it.
    """
    if sys.platform.startswith("linux"):
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(-3, 32 * 2**20)  # M_MMAP_THRESHOLD, at its maximum
            mallopt(-1, 2**31 - 1)  # M_TRIM_THRESHOLD


def _open_run(folder: Path, recipe: Recipe, pushes: Pushes) -> None:
    """Write what the run is, or check that the folder holds the same one."""
    folder.mkdir(parents=True, exist_ok=True)
    config = {
        "recipe": recipe.record(),
        "data": {"source": pushes.source, "sha256": pushes.digest},
        "code_version": service.__version__,
    }
    text = json.dumps(config, indent=2, sort_keys=True) + "\n"
    path = folder / CONFIG_FILE
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise DataError(f"{path} records another run (recipe, data or code version); choose another --run or remove it")
    path.write_text(text, encoding="utf-8")


def _save_checkpoint(folder: Path, network: PushNetwork, adam: torch.optim.Optimizer, next_epoch: int) -> None:
    part = folder / (CHECKPOINT_FILE + ".part")
    torch.save({"network": network.state_dict(), "adam": adam.state_dict(), "next_epoch": next_epoch}, part)
    part.replace(folder / CHECKPOINT_FILE)


def _resume(folder: Path, network: PushNetwork, adam: torch.optim.Optimizer) -> int:
    """Load the last checkpoint, drop the metrics written after it, and return the epoch to go on with."""
    path, metrics = folder / CHECKPOINT_FILE, folder / METRICS_FILE
    next_epoch = 0
    if path.is_file():
        checkpoint = torch.load(path, weights_only=True)
        network.load_state_dict(checkpoint["network"])
        adam.load_state_dict(checkpoint["adam"])
        next_epoch = int(checkpoint["next_epoch"])
    if metrics.is_file():
        lines = metrics.read_text(encoding="utf-8").splitlines(keepends=True)
        metrics.write_text("".join(lines[:next_epoch]), encoding="utf-8")
    return next_epoch
