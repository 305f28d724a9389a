"""Parity inputs: batches on which a graph is compared with its network, plausible ones and extreme ones."""

import math
from dataclasses import dataclass

import numpy as np

from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import MAX_SUPPORT, VISUAL_SIZE, SupportContext
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angles
from service.pushing.shape_context import CORNERS, ShapeContext


@dataclass(frozen=True)
class Batch:
    """Inputs of a graph."""

    pusher: FloatArray  # (n, 3), or (n, 4) for shapes
    contexts: tuple[FloatArray, ...]  # (g, 36), (g, 1, 32, 32), or the tensors of shapes or supports
    context_index: IndexArray  # (n,)


def plausible_batch(kind: ContextKind, pushes: int, objects: int, seed: int = 0) -> Batch:
    """Draw plausible pushes of random objects, the same for the same seed."""
    rng = np.random.default_rng(seed)
    contexts = _random_contexts(kind, rng, objects)
    columns = [_towards_centre(rng, pushes)]
    if kind is ContextKind.SHAPE:
        columns.append(rng.uniform(0.01, 0.1, pushes))
    pusher = np.column_stack(columns).astype(np.float32)
    return Batch(pusher, contexts, rng.integers(objects, size=pushes))


def _random_contexts(kind: ContextKind, rng: np.random.Generator, objects: int) -> tuple[FloatArray, ...]:
    match kind:
        case ContextKind.NONE:
            return ()
        case ContextKind.INDICATOR:
            return (_random_indicators(rng, objects),)
        case ContextKind.VISUAL:
            return (_random_views(rng, objects),)
        case ContextKind.SUPPORT:
            supports = [_random_support(rng).tensors() for _ in range(objects)]
            return tuple(map(np.stack, zip(*supports, strict=True)))
        case ContextKind.SHAPE:
            shapes = [_random_shape(rng).tensors() for _ in range(objects)]
            return tuple(map(np.stack, zip(*shapes, strict=True)))


def _random_shape(rng: np.random.Generator) -> ShapeContext:
    """Draw an outline of 3 to 64 corners around its origin, 20 to 70 mm from it, of which anything may be known."""
    count = int(rng.integers(3, CORNERS + 1))
    bearing = (np.arange(count) + rng.uniform(0.0, 0.8, count)) / count * 2.0 * math.pi
    outline = Outline.of(np.stack([np.cos(bearing), np.sin(bearing)], axis=1) * rng.uniform(0.02, 0.07, (count, 1)))
    known = rng.random(3) < 0.5
    return ShapeContext(
        outline,
        (float(rng.normal(0.0, 0.005)), float(rng.normal(0.0, 0.005))) if known[0] else None,
        float(rng.uniform(0.1, 0.5)) if known[1] else None,
        float(rng.uniform(0.003, 0.01)) if known[2] else None,
    )


def _random_support(rng: np.random.Generator) -> SupportContext:
    """Draw a support of 1 to 50 pushes from all around, with outcomes of up to 50 mm and half a radian."""
    count = int(rng.integers(1, MAX_SUPPORT + 1))
    outcomes = rng.uniform(-1.0, 1.0, (count, 3)) * (0.035, 0.035, 0.5)
    return SupportContext.of(_towards_centre(rng, count), outcomes)


def _towards_centre(rng: np.random.Generator, pushes: int) -> DoubleArray:
    """Draw pushes (n, 3) that start 80 mm from the centre and head towards it."""
    bearing = rng.uniform(-math.pi, math.pi, pushes)
    start = 0.08 * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    angle = bearing + math.pi + rng.uniform(-0.3, 0.3, pushes)
    return np.column_stack([start, wrap_angles(angle)])


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
    plausible = plausible_batch(kind, 1, 6, seed=1).contexts
    if kind is ContextKind.SHAPE:  # there is no empty and no full shape
        lengths = np.array((1e-6, 0.05, 1.0), dtype=np.float32)[np.arange(len(pusher)) % 3]
        return Batch(np.column_stack([pusher, lengths]), plausible, np.arange(len(pusher)) % len(plausible[0]))
    contexts = tuple(np.concatenate([np.zeros_like(some[:1]), np.ones_like(some[:1]), some]) for some in plausible)
    return Batch(pusher, contexts, np.arange(len(pusher)) % (len(contexts[0]) if contexts else 1))


def graph_inputs(batch: Batch, kind: ContextKind) -> tuple[FloatArray | IndexArray, ...]:
    """Return the arrays that a graph of this kind takes, in order."""
    return (batch.pusher,) if kind is ContextKind.NONE else (batch.pusher, *batch.contexts, batch.context_index)
