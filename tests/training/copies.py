"""Synthetic copies of Omnipush for tests: laid out as published, with plausible statistics, never called real."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from training.omnipush.declaration import declare_dataset
from training.omnipush.files import Array, Variant
from training.omnipush.pushes import write_object

SOURCE = "synthetic pushes of a test"


def plausible_pushes(count: int, seed: int) -> tuple[Array, Array]:
    """Pushers around an object and outcomes with the published spread, (count, 3) each."""
    rng = np.random.default_rng(seed)
    bearing, radius = rng.uniform(-math.pi, math.pi, count), rng.uniform(0.075, 0.084, count)
    angle = np.angle(np.exp(1j * (bearing + math.pi + rng.normal(0.0, 0.2, count))))
    pushers = np.column_stack([radius * np.cos(bearing), radius * np.sin(bearing), angle])
    return pushers, np.column_stack([0.022 * np.cos(angle), 0.022 * np.sin(angle), rng.normal(0.0, 0.215, count)])


def write_surface(
    folder: Path, descriptors: Iterable[str], rows: int = 250, variants: Iterable[Variant] = (Variant.RAW,)
) -> Path:
    """A folder of these objects, declared as what it is."""
    declare_dataset(folder, {"source": SOURCE})
    for number, descriptor in enumerate(descriptors):
        write_object(folder, descriptor, *plausible_pushes(rows, number), tuple(variants))
    return folder


def write_views(folder: Path, descriptors: Iterable[str], size: int = 481) -> Path:
    """A folder of blank views; one file under many names."""
    folder.mkdir(parents=True, exist_ok=True)
    blank = folder / "blank.npy"
    np.save(blank, np.zeros((size, size), dtype=np.uint8))
    for descriptor in descriptors:
        (folder / f"shape_{descriptor}.npy").symlink_to(blank.resolve())
    return folder
