"""The training loop: Siamese halves of a batch of objects, Adam, and a metrics line per epoch.

``run_folder`` describes the files that a run writes. Batches and all other random numbers depend on the seed and the
epoch's number alone. A run that was killed therefore continues from its last checkpoint and ends in the same weights as
an uninterrupted run. That holds on any number of threads (see ``sharded_gradients``), for a neural process on one.
"""

import ctypes
import json
import math
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from training.fitting import neural_process_step, run_folder, sharded_gradients
from training.fitting.augmentation import augmented
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import METRICS_FILE, Network, TimeSpent, build_network
from training.fitting.samples import Samples, TrainingData
from training.fitting.sharded_gradients import ShardMap, thread_pool
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PushNetwork

CHECKPOINT_EVERY_S: Final = 30.0
HELD_OUT_EVERY_EPOCHS: Final = 25


def fit(recipe: Recipe, data: TrainingData, folder: Path, quiet: bool = False, bar: int = 0) -> Network:
    """Train a recipe, or continue the run in ``folder``. Return the network with the weights of the last epoch.

    ``bar`` is the terminal line of the progress bar, for callers that show bars of their own.

    Raises:
        DataError: the folder holds another run.
    """
    keep_freed_memory()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    train, held_out = data.train.to(device), data.held_out.to(device)
    dtype = product_dtype(recipe.precision, device)

    torch.manual_seed(recipe.seed)
    network = build_network(recipe, train.shape).to(device)
    adam = torch.optim.Adam(network.parameters(), lr=recipe.learning_rate, fused=True)
    run_folder.open_run(folder, recipe, data)
    first_epoch, before = run_folder.resume(folder, network, adam)

    rmse, spent = float("nan"), before
    started = saved_at = TimeSpent.now()
    with (
        (folder / METRICS_FILE).open("a", encoding="utf-8") as metrics,
        _progress_bar(recipe, first_epoch, quiet, bar) as progress,
    ):
        for epoch in progress:
            last = epoch == recipe.epochs - 1
            likelihood, penalty = train_epoch(network, adam, train, recipe, epoch, dtype)
            line = {"epoch": epoch, "nll": likelihood, "regulariser": penalty}
            if len(held_out.inputs) > 0 and (last or epoch % HELD_OUT_EVERY_EPOCHS == 0):
                line["held_out_rmse"] = rmse = evaluate(network, held_out).rmse
            metrics.write(json.dumps(line) + "\n")
            progress.set_postfix(loss=f"{likelihood + penalty:.3f}", held_out_rmse=f"{rmse:.3f}", refresh=False)
            now = TimeSpent.now()
            if last or now.seconds - saved_at.seconds > CHECKPOINT_EVERY_S:
                metrics.flush()
                spent = now.since(started, before)
                run_folder.save_checkpoint(folder, network, adam, epoch + 1, spent)
                saved_at = now
    if first_epoch < recipe.epochs:
        times = {name: round(value, 1) for name, value in spent._asdict().items()}
        precision = str(dtype).removeprefix("torch.")
        run_folder.write_cost(folder, {**times, "device": device.type, "precision": precision})
    run_folder.write_weights(folder, network)
    return network.eval()


def _progress_bar(recipe: Recipe, first_epoch: int, quiet: bool, bar: int) -> "tqdm[int]":
    """Return the epochs that are left, shown as a progress bar."""
    return tqdm(
        range(first_epoch, recipe.epochs),
        initial=first_epoch,
        total=recipe.epochs,
        desc=recipe.method,
        unit="epoch",
        disable=quiet,
        position=bar,
        leave=bar == 0,
    )


def train_epoch(
    network: Network,
    adam: torch.optim.Optimizer,
    train: Samples,
    recipe: Recipe,
    epoch: int,
    dtype: torch.dtype = torch.float32,
) -> tuple[float, float]:
    """Train one pass over all objects. Return mean likelihood and penalty (regulariser or divergence) per batch."""
    rng = np.random.default_rng([recipe.seed, epoch])
    order = torch.from_numpy(rng.permutation(len(train.context))).to(train.context.device)
    batches = torch.split(order, recipe.batch_objects)
    if isinstance(network, NeuralProcess):  # it draws supports and latents too: again from seed and epoch alone
        torch.manual_seed(int(rng.integers(2**63)))
    network.train()
    sums = torch.zeros(2, device=train.context.device)
    with thread_pool() if isinstance(network, PushNetwork) else nullcontext(map) as shard_map:
        for step, objects in enumerate(batches, start=1 + epoch * len(batches)):
            adam.param_groups[0]["lr"] = learning_rate(recipe, step) * cooling(recipe, epoch)
            batch = augmented(train.select(objects), recipe.symmetries, recipe.no_contact, rng)
            sums += torch.stack(_set_gradients(network, batch, recipe, dtype, shard_map))
            adam.step()
    mean_likelihood, mean_penalty = (sums / len(batches)).tolist()
    return mean_likelihood, mean_penalty


def learning_rate(recipe: Recipe, step: int) -> float:
    """Return the rate of a step, counted from 1: ``rate sqrt(w) min(step w^-1.5, step^-0.5)`` with w warm-up steps."""
    warm_up = recipe.warm_up_steps
    if warm_up == 0:
        return recipe.learning_rate
    return recipe.learning_rate * math.sqrt(warm_up) * min(step / math.pow(warm_up, 1.5), 1.0 / math.sqrt(step))


def cooling(recipe: Recipe, epoch: int) -> float:
    """Return the factor of the learning rate in an epoch: 1, then half a cosine down to 0 over the cooling epochs."""
    left, cooling_epochs = recipe.epochs - epoch, recipe.cooling_epochs
    if cooling_epochs == 0 or left > cooling_epochs:
        return 1.0
    return 0.5 - 0.5 * math.cos(math.pi * left / (cooling_epochs + 1))


def product_dtype(precision: str, device: torch.device) -> torch.dtype:
    """Return the type of the wide matrix products. ``auto`` is bfloat16 where the processor multiplies it natively."""
    if precision != "auto":
        return torch.bfloat16 if precision == "bfloat16" else torch.float32
    if device.type == "cuda":
        able = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        processor = torch.cpu.get_capabilities()
        able = any(processor.get(name) for name in ("avx512_bf16", "amx_bf16"))
    return torch.bfloat16 if able else torch.float32


def _set_gradients(
    network: Network, batch: Samples, recipe: Recipe, dtype: torch.dtype, shard_map: ShardMap
) -> tuple[Tensor, Tensor]:
    """Set the gradients of the loss of a batch. Return likelihood and penalty."""
    if isinstance(network, NeuralProcess):
        return neural_process_step.set_gradients(network, batch, recipe, dtype)
    return sharded_gradients.set_gradients(network, batch, recipe, dtype, shard_map)


def keep_freed_memory() -> None:
    """Ask glibc to reuse a step's large activations in the next step instead of returning them to the kernel.

    Page faults for 16 MB blocks cost about a tenth of an epoch. Other allocators ignore the request.
    """
    if sys.platform.startswith("linux"):
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(-3, 32 * 2**20)  # M_MMAP_THRESHOLD, at its maximum
            mallopt(-1, 2**31 - 1)  # M_TRIM_THRESHOLD
