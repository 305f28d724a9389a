"""Synthetic copies of Omnipush for tests: laid out as published, with plausible statistics, declared as synthetic."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from training.omnipush.declaration import declare_dataset
from training.omnipush.files import Array, Variant
from training.omnipush.published import omnipush_descriptors, recorded_outcomes
from training.omnipush.pushes import write_object
from training.omnipush.views import view_file_name
from training.simulation import drawing

SOURCE = "synthetic pushes of a test"


def plausible_pushes(count: int, seed: int) -> tuple[Array, Array]:
    """Draw pushers around an object and outcomes spread as those recorded, (count, 3) each."""
    rng = np.random.default_rng(seed)
    bearing, radius = rng.uniform(-math.pi, math.pi, count), rng.uniform(0.075, 0.084, count)
    angle = np.angle(np.exp(1j * (bearing + math.pi + rng.normal(0.0, 0.2, count))))
    pushers = np.column_stack([radius * np.cos(bearing), radius * np.sin(bearing), angle])
    recorded, levels = recorded_outcomes(), rng.uniform(0.0, 1.0, (2, count))
    places = (0.0, *recorded.quantiles, 1.0)
    distance = np.interp(levels[0], places, (1.1, *recorded.distance_mm, 40.0)) / 1e3
    yaw = np.radians(np.interp(levels[1], places, (0.0, *recorded.turn_deg, 30.0))) * rng.choice((-1.0, 1.0), count)
    return pushers, np.column_stack([distance * np.cos(angle), distance * np.sin(angle), yaw])


def write_surface(
    folder: Path, descriptors: Iterable[str], rows: int = 250, variants: Iterable[Variant] = (Variant.RAW,)
) -> Path:
    """Write a folder of synthetic pushes of these objects, with a declaration."""
    declare_dataset(folder, {"source": SOURCE})
    for number, descriptor in enumerate(descriptors):
        write_object(folder, descriptor, *plausible_pushes(rows, number), tuple(variants))
    return folder


def write_views(folder: Path, descriptors: Iterable[str], size: int = 481) -> Path:
    """Write a folder of blank views, which are links to one file."""
    folder.mkdir(parents=True, exist_ok=True)
    blank = folder / "blank.npy"
    np.save(blank, np.zeros((size, size), dtype=np.uint8))
    for descriptor in descriptors:
        (folder / view_file_name(descriptor)).symlink_to(blank.resolve())
    return folder


def write_linked_views(folder: Path, without: str = "") -> Path:
    """Draw the view of the first object into a declared folder, and link it as the views of all others but one."""
    first, *others = (folder / view_file_name(descriptor) for descriptor in omnipush_descriptors())
    drawing.write_views(folder, omnipush_descriptors()[:1], quiet=True)
    for path in others:
        if path.name != without:
            path.hardlink_to(first)
    return folder
