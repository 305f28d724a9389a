"""The training loop: Siamese halves of a batch of objects, Adam, a record of every epoch.

A run folder holds ``config.json`` (recipe, data, code version), ``metrics.jsonl`` (a line per epoch), ``checkpoint.pt``
(while running) and at the end ``cost.json`` (``Spent``, device) and ``weights.safetensors``. Batches, and all else that
is random, depend on the seed and the epoch's number alone, so a run that was killed continues from its last checkpoint
as one that was not: to the same weights, on any number of threads (see ``shards``; a neural process on one only).
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

from training.fitting import neural_process_step
from training.fitting.augmentation import augmented
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import (
    METRICS_FILE,
    Network,
    Spent,
    _open_run,
    _resume,
    _save_checkpoint,
    _write_cost,
    _write_weights,
    build_network,
)
from training.fitting.samples import Samples, TrainingData
from training.fitting.sharded_gradients import Mapper, cores, set_gradients
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PushNetwork

CHECKPOINT_EVERY_S: Final = 30.0
HELD_OUT_EVERY_EPOCHS: Final = 25


def fit(recipe: Recipe, data: TrainingData, folder: Path, quiet: bool = False, bar: int = 0) -> Network:
    """Train what the recipe says, or continue where the run folder stopped; the weights of the last epoch.

    ``bar`` is the line of the progress bar, for callers that have bars of their own.

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
    _open_run(folder, recipe, data)
    first_epoch, before = _resume(folder, network, adam)

    rmse, spent = float("nan"), before
    started = saved_at = Spent.now()
    with (
        (folder / METRICS_FILE).open("a", encoding="utf-8") as metrics,
        tqdm(
            range(first_epoch, recipe.epochs),
            initial=first_epoch,
            total=recipe.epochs,
            desc=recipe.method,
            unit="epoch",
            disable=quiet,
            position=bar,
            leave=bar == 0,
        ) as progress,
    ):
        for epoch in progress:
            likelihood, penalty = train_epoch(network, adam, train, recipe, epoch, dtype)
            last = epoch == recipe.epochs - 1
            line = {"epoch": epoch, "nll": likelihood, "regulariser": penalty}
            if len(held_out.inputs) > 0 and (last or epoch % HELD_OUT_EVERY_EPOCHS == 0):
                rmse = evaluate(network, held_out).rmse
                line["held_out_rmse"] = rmse
            metrics.write(json.dumps(line) + "\n")
            progress.set_postfix(loss=f"{likelihood + penalty:.3f}", held_out_rmse=f"{rmse:.3f}", refresh=False)
            now = Spent.now()
            if last or now.seconds - saved_at.seconds > CHECKPOINT_EVERY_S:
                metrics.flush()
                spent = now.since(started, before)
                _save_checkpoint(folder, network, adam, epoch + 1, spent)
                saved_at = now
    if first_epoch < recipe.epochs:
        figures = {name: round(value, 1) for name, value in spent._asdict().items()}
        _write_cost(folder, {**figures, "device": device.type, "precision": str(dtype)[6:]})
    _write_weights(folder, network)
    return network.eval()


def train_epoch(
    network: Network,
    adam: torch.optim.Optimizer,
    train: Samples,
    recipe: Recipe,
    epoch: int,
    dtype: torch.dtype = torch.float32,
) -> tuple[float, float]:
    """One pass over all objects; the mean likelihood and penalty (regulariser, or divergence) over its batches."""
    rng = np.random.default_rng([recipe.seed, epoch])
    order = torch.from_numpy(rng.permutation(len(train.context))).to(train.context.device)
    batches = torch.split(order, recipe.batch_objects)
    if isinstance(network, NeuralProcess):  # it draws supports and latents as well, again from seed and epoch alone
        torch.manual_seed(int(rng.integers(2**63)))
    network.train()
    sums = torch.zeros(2, device=train.context.device)
    with cores() if isinstance(network, PushNetwork) else nullcontext(map) as run:
        for step, batch in enumerate(batches, start=1 + epoch * len(batches)):
            adam.param_groups[0]["lr"] = learning_rate(recipe, step) * cooling(recipe, epoch)
            met = augmented(train.select(batch), recipe.symmetries, recipe.no_contact, rng)
            sums += torch.stack(_set_gradients(network, met, recipe, dtype, run))
            adam.step()
    mean_likelihood, mean_penalty = (sums / len(batches)).tolist()
    return mean_likelihood, mean_penalty


def learning_rate(recipe: Recipe, step: int) -> float:
    """The rate of a step, counted from 1: ``rate sqrt(w) min(step w^-1.5, step^-0.5)`` with w steps of warm-up."""
    warm_up = recipe.warm_up_steps
    if warm_up == 0:
        return recipe.learning_rate
    return recipe.learning_rate * math.sqrt(warm_up) * min(step / math.pow(warm_up, 1.5), 1.0 / math.sqrt(step))


def cooling(recipe: Recipe, epoch: int) -> float:
    """The factor of the learning rate in an epoch: 1, and over the last epochs half a cosine down to 0."""
    left, cooling_epochs = recipe.epochs - epoch, recipe.cooling_epochs
    if cooling_epochs == 0 or left > cooling_epochs:
        return 1.0
    return 0.5 - 0.5 * math.cos(math.pi * left / (cooling_epochs + 1))


def product_dtype(precision: str, device: torch.device) -> torch.dtype:
    """The type of the wide matrix products; ``auto`` takes bfloat16 where the processor itself multiplies it."""
    if precision != "auto":
        return torch.bfloat16 if precision == "bfloat16" else torch.float32
    if device.type == "cuda":
        able = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        processor = torch.cpu.get_capabilities()
        able = any(processor.get(name) for name in ("avx512_bf16", "amx_bf16"))
    return torch.bfloat16 if able else torch.float32


def _set_gradients(
    network: Network, batch: Samples, recipe: Recipe, dtype: torch.dtype, run: Mapper
) -> tuple[Tensor, Tensor]:
    """Set the gradient of the loss of a batch; likelihood and penalty."""
    if isinstance(network, NeuralProcess):
        return neural_process_step.set_gradients(network, batch, dtype)
    return set_gradients(network, batch, recipe, dtype, run)


def keep_freed_memory() -> None:
    """Ask glibc to reuse the large activations of a step in the next one instead of returning them to the kernel.

    Faulting 16 MB pages in again costs about a tenth of an epoch. Other allocators ignore it.
    """
    if sys.platform.startswith("linux"):
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(-3, 32 * 2**20)  # M_MMAP_THRESHOLD, at its maximum
            mallopt(-1, 2**31 - 1)  # M_TRIM_THRESHOLD
