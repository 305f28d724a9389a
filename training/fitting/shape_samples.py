"""Samples of shapes: a table of pushes as batches of the tensors that are served, and as samples to fit networks on.

Each object enters the training several times, each time with another part of its body known. Unknown values are those
that a client would leave out: a centre of mass near the centroid, and a friction and a tip near the defaults. So an
answer to a client who knows the outline alone is that for plain objects, with the scatter of those.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from tqdm import tqdm

from service.model.tensors import FloatArray, IndexArray
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import FRICTION, PUSHER_RADIUS_M, ShapeContext
from training.fitting.recipe import DIFFERENT_FAMILIES
from training.fitting.samples import Samples, TrainingData
from training.networks.mechanics import Mechanics, PushMechanics
from training.networks.shape_features import context_inputs, push_inputs, residual_unit
from training.tables.push_table import PushTable
from training.tables.reading import read_table
from training.tables.splits import split_by_object

HELD_OUT_FAMILIES: Final = ("irregular-polygon", "T", "wrench", "bean")  # one of each kind
HELD_OUT_SHARE: Final = 0.1  # of the objects of each family, for the conformal factor
COPIES: Final = 2  # of each object, with different parts of its body known
ROWS_AT_ONCE: Final = 4096
_PLAIN: Final = 0.02  # of the size: a centre of mass nearer to the centroid is at the centroid for a client
_PLAIN_KNOWN, _LOADED_KNOWN = 0.4, 0.85  # how often centres of mass are known
_UNKNOWN: Final = 0.75  # how often a friction or a tip of the default is unknown
_NEAR: Final = 0.35  # logarithm: values this far from the default are unknown 0.6 times as often
Known = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ShapeBatch:
    """Pushes and objects as a shape model takes them, and the outcomes."""

    pusher: FloatArray  # (n, 4)
    contexts: tuple[FloatArray, ...]  # silhouette, outline, support and body of g objects
    context_index: IndexArray  # (n,)
    outcomes: DoubleArray  # (n, 3)

    def tensors(self) -> tuple[torch.Tensor, ...]:
        """Return the inputs of a shape network, in order."""
        return tuple(torch.from_numpy(part) for part in (self.pusher, *self.contexts, self.context_index))


def shape_batch(table: PushTable, known: Known) -> ShapeBatch:
    """Return a table as a batch. ``known`` (objects, 3): centre of mass, friction and tip of each object.

    Values that a table does not have are unknown anyway. An object is pushed by one tip.
    """
    radius_m = np.full(len(table.objects), PUSHER_RADIUS_M)
    radius_m[table.object_index] = table.pusher_radius_m
    found = [
        ShapeContext(
            item.outline,
            item.centre_of_mass_m if centre else None,
            item.friction if friction else None,
            float(radius) if tip else None,
        ).tensors()
        for item, radius, (centre, friction, tip) in zip(table.objects, radius_m, known, strict=True)
    ]
    contexts = tuple(map(np.stack, zip(*found, strict=True)))
    return ShapeBatch(table.pushers.astype(np.float32), contexts, table.object_index, table.outcomes)


def draw_known(table: PushTable, rng: np.random.Generator) -> Known:
    """Draw which values of each object are known, (objects, 3): centre of mass, friction and tip."""
    radius_m = np.full(len(table.objects), PUSHER_RADIUS_M)
    radius_m[table.object_index] = table.pusher_radius_m
    known = np.empty((len(table.objects), 3), dtype=np.bool_)
    for row, (item, radius) in enumerate(zip(table.objects, radius_m, strict=True)):
        outline = item.outline
        centre = outline.centroid_m if item.centre_of_mass_m is None else np.array(item.centre_of_mass_m)
        loaded = np.hypot(*(centre - outline.centroid_m)) > _PLAIN * outline.size_m
        unknown = [_unknown(value, usual) for value, usual in ((item.friction, FRICTION), (radius, PUSHER_RADIUS_M))]
        known[row] = rng.random(3) >= (1.0 - (_LOADED_KNOWN if loaded else _PLAIN_KNOWN), *unknown)
    return known


def _unknown(value: float | None, usual: float) -> float:
    """Return how often a value is unknown."""
    return 1.0 if value is None else _UNKNOWN * math.exp(-0.5 * (math.log(value / usual) / _NEAR) ** 2)


def shape_samples(table: PushTable, known: list[Known], quiet: bool = False) -> Samples:
    """Return the samples of a table, each object once for each of ``known``: inputs, residuals, contexts.

    Pushes that miss are left out, because their answer needs no network.
    """
    parts = [_object_samples(table, each, quiet) for each in known]
    first = parts[0]
    inputs, targets, valid, context = (
        torch.cat([getattr(part, name) for part in parts]) for name in ("inputs", "targets", "valid", "context")
    )
    return Samples(inputs, targets, valid, context, first.target_std)


def _object_samples(table: PushTable, known: Known, quiet: bool) -> Samples:
    batch = shape_batch(table, known)
    pusher, silhouette, _, _, body, index = batch.tensors()
    found = mechanics_of(batch, quiet)
    rows = body[index]
    inputs = push_inputs(found, pusher, rows)
    targets = (_motions(batch, rows) - found.motion) / residual_unit(found.left)
    counts = torch.bincount(index, minlength=len(body))
    order = torch.argsort(index, stable=True)
    place = torch.arange(len(index)) - torch.repeat_interleave(torch.cumsum(counts, 0) - counts, counts)
    where = index[order], place

    def by_object(values: torch.Tensor) -> torch.Tensor:
        """Return rows (n, ...) as (objects, most pushes, ...), padded with zeros."""
        padded = torch.zeros((len(body), int(counts.max()), *values.shape[1:]))
        padded[where] = values[order]
        return padded

    return Samples(
        by_object(inputs), by_object(targets), by_object(found.touches), context_inputs(silhouette, body), (1.0,) * 3
    )


def mechanics_of(batch: ShapeBatch, quiet: bool = False) -> Mechanics:
    """Return the mechanics of a batch."""
    module = PushMechanics()
    pusher, _, outline, support, body, index = batch.tensors()
    parts = []
    with torch.inference_mode(), tqdm(total=len(pusher), desc="mechanics", unit="push", disable=quiet) as progress:
        for start in range(0, len(pusher), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            parts.append(module(pusher[part], outline, support, body, index[part]))
            progress.update(len(parts[-1].left))
    return Mechanics(*(torch.cat(columns) for columns in zip(*parts, strict=True)))


def _motions(batch: ShapeBatch, body: torch.Tensor) -> torch.Tensor:
    """Return the motions (n, 3) of centroids in push frames, in sizes, and yaws, that outcomes (n, 3) are."""
    centroid, size, angle = (
        body[:, 0:2].double(),
        body[:, 2:3].double(),
        torch.from_numpy(batch.pusher[:, 2:3]).double(),
    )
    outcome = torch.from_numpy(batch.outcomes)
    yaw = outcome[:, 2:]

    def turned(vectors: torch.Tensor, by: torch.Tensor) -> torch.Tensor:
        """Return vectors (n, 2) turned by angles (n, 1)."""
        x, y = vectors[:, :1], vectors[:, 1:]
        return torch.cat([torch.cos(by) * x - torch.sin(by) * y, torch.sin(by) * x + torch.cos(by) * y], dim=1)

    moved = outcome[:, :2] - centroid + turned(centroid, yaw)
    return torch.cat([turned(moved, -angle) / size, yaw], dim=1).float()


@dataclass(frozen=True)
class ShapeSplit:
    """Parts of a table of shapes: to train on, held out of the families seen, and families never seen."""

    train: PushTable
    held_out: PushTable
    unseen: PushTable | None  # None if every family is trained on


def split_shapes(table: PushTable, set_up: str) -> ShapeSplit:
    """Split a table by whole objects, and for ``different-families`` by families.

    Raises:
        DataError: the table is too small.
    """
    unseen = None
    families = table.labels.get("family")
    if set_up == DIFFERENT_FAMILIES and families is not None:
        rows = np.isin(np.array(families.values)[families.index], HELD_OUT_FAMILIES)
        unseen, table = table.select(rows), table.select(~rows)
    train, held_out = split_by_object(table, HELD_OUT_SHARE)
    return ShapeSplit(train, held_out, unseen)


def read_shapes(folder: Path, set_up: str) -> tuple[PushTable, ShapeSplit]:
    """Read a table of pushes of shapes, and split it.

    Raises:
        DataError: the table cannot be read or is too small.
    """
    table = read_table(folder)
    return table, split_shapes(table, set_up)


def shape_training_data(table: PushTable, split: ShapeSplit, seed: int, quiet: bool = False) -> TrainingData:
    """Return the data of a run: samples to train on, and those of held-out objects."""
    rng = np.random.default_rng([seed, 24])
    train = shape_samples(split.train, [draw_known(split.train, rng) for _ in range(COPIES)], quiet)
    held_out = shape_samples(split.held_out, [draw_known(split.held_out, rng)], quiet)
    return TrainingData(train, held_out, {"source": table.source, "sha256": table.digest})
