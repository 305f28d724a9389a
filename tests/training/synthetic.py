"""Small data, small recipes, and the paper's network a second time, in numpy."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.contract import ObjectContext
from training.data import declare_dataset, omnipush_descriptors, read_folder, write_object
from training.fit import fit
from training.recipes import Recipe

Array = npt.NDArray[np.float64]

SOURCE: Final = "synthetic pushes of a test"
RECIPE: Final = Recipe(
    name="push-indicator",
    method="FCN + CM + L2Reg",
    set_up="different-objects",
    epochs=3,
    batch_objects=64,
    learning_rate=0.002,
    lambda_1=0.01,
    lambda_2=10.0,
    seed=0,
)


def write_data(folder: Path) -> Path:
    """One to three pushes of each of the 250 objects, simple enough to learn: heavy objects turn more."""
    rng = np.random.default_rng(20)
    declare_dataset(folder, {"source": SOURCE})
    for number, descriptor in enumerate(omnipush_descriptors()):
        bearing = rng.uniform(-math.pi, math.pi, 1 + number % 3)
        angle = np.angle(np.exp(1j * (bearing + math.pi)))
        pushers = np.column_stack([0.08 * np.cos(bearing), 0.08 * np.sin(bearing), angle])
        weights = sum(side.weight != "a" for side in ObjectContext.from_descriptor(descriptor).sides)
        turn = np.full(len(bearing), 0.1 * weights)
        write_object(folder, descriptor, pushers, np.column_stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), turn]))
    return folder


def finish_run(folder: Path, data_folder: Path, method: str) -> Path:
    """A run of a few epochs on the synthetic pushes, finished."""
    name = "push-none" if method == "FCN" else "push-indicator"
    fit(replace(RECIPE, method=method, name=name), read_folder(data_folder), folder, quiet=True)
    return folder


def numpy_network(
    weights: Mapping[str, Tensor], pusher: Array, indicator: Array | None
) -> tuple[Array, Array, Array | None]:
    """Mean, log std and mask of normalised pushes (n, 3) of one object, from the paper's equations.

    ``g(x, c) = g4(g3(g2(g1(x) * m(c))))`` and ``m(c) = ReLU(W c + b)``.
    """

    def dense(name: str, value: Array) -> Array:
        result: Array = value @ array_of(weights[f"{name}.weight"]).T + array_of(weights[f"{name}.bias"])
        return result

    mask = None if indicator is None else np.maximum(dense("context_mask", indicator), 0.0)
    hidden = np.maximum(dense("first", pusher), 0.0)
    if mask is not None:
        hidden = hidden * mask
    for layer in ("second", "third"):
        hidden = np.maximum(dense(layer, hidden), 0.0)
    output = dense("last", hidden)
    return output[:, :3], output[:, 3:], mask


def array_of(tensor: Tensor) -> Array:
    """The numbers of a tensor in double precision."""
    array: Array = tensor.detach().to(torch.float64).numpy()
    return array
