"""Parity inputs: batches on which a graph is compared with its network, plausible ones and extreme ones."""

import math
from dataclasses import dataclass

import numpy as np

from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import VISUAL_SIZE
from service.pushing.poses import wrap_angles


@dataclass(frozen=True)
class Batch:
    """Inputs of a graph."""

    pusher: FloatArray  # (n, 3)
    context: FloatArray  # (g, 36) or (g, 1, 32, 32)
    context_index: IndexArray  # (n,)


def plausible_batch(kind: ContextKind, pushes: int, objects: int, seed: int = 0) -> Batch:
    """Draw plausible pushes of random objects, the same for the same seed."""
    rng = np.random.default_rng(seed)
    context = _random_views(rng, objects) if kind is ContextKind.VISUAL else _random_indicators(rng, objects)
    bearing = rng.uniform(-math.pi, math.pi, pushes)
    start = 0.08 * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    angle = bearing + math.pi + rng.uniform(-0.3, 0.3, pushes)
    pusher = np.column_stack([start, wrap_angles(angle)]).astype(np.float32)
    return Batch(pusher, context, rng.integers(objects, size=pushes))


def _random_indicators(rng: np.random.Generator, objects: int) -> FloatArray:
    """Draw the indicators (objects, 36) of objects that can exist."""
    shapes, weights = rng.integers(4, size=(objects, 4)), rng.integers(3, size=(objects, 4))
    sides = np.concatenate([np.eye(4)[shapes], np.eye(5)[weights]], axis=-1)
    return sides.reshape(objects, 36).astype(np.float32)


def _random_views(rng: np.random.Generator, objects: int) -> FloatArray:
    """Draw bright rectangles with a dark spot on a dark ground, (objects, 1, 32, 32) in steps of 1/255."""
    levels = np.zeros((objects, 1, VISUAL_SIZE, VISUAL_SIZE), dtype=np.uint8)
    for view in levels[:, 0]:
        top, left, bottom, right = (*rng.integers(2, 10, size=2), *rng.integers(20, 30, size=2))
        view[top:bottom, left:right] = rng.integers(80, 256)
        row, column = rng.integers(12, 18, size=2)
        view[row : row + 4, column : column + 4] = rng.integers(0, 80)
    return levels.astype(np.float32) / np.float32(255.0)


def extreme_batch(kind: ContextKind) -> Batch:
    """Return inputs at all limits: angles at pi and many turns away, positions up to 1 m, empty and full contexts.

    Further away float32 is too coarse: activations grow with the distance, and a wrapped angle keeps their error.
    """
    places = (-1.0, -0.05, -0.0, 1e-30, 0.05, 1.0)
    angles = (-1e3, -1.0, -math.pi, -0.0, 1e-30, math.pi, 1.0, 1e3)
    pusher = np.array([(x, y, angle) for x in places for y in places for angle in angles], dtype=np.float32)
    plausible = plausible_batch(kind, 1, 6, seed=1).context
    context = np.concatenate([np.zeros_like(plausible[:1]), np.ones_like(plausible[:1]), plausible])
    return Batch(pusher, context, np.arange(len(pusher)) % len(context))


def graph_inputs(batch: Batch, kind: ContextKind) -> tuple[FloatArray | IndexArray, ...]:
    """Return the arrays that a graph of this kind takes, in order."""
    return (batch.pusher,) if kind is ContextKind.NONE else (batch.pusher, batch.context, batch.context_index)
