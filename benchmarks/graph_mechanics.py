"""Mechanics inside a graph: error and time for numbers of steps, beside the mechanics of the service.

    python -m benchmarks.graph_mechanics FOLDER [--limit 1000] [--steps 4 6 8]

FOLDER holds a table of pushes of any objects, recorded or simulated (docs/data.md). All know the outline alone. Printed
for each are the mean and median error against the outcomes of the table, how far it is from the simulation of even
pressure without scatter, its operators, and the lowest time of one push and of 1,000 pushes of one object in
onnxruntime on one thread, through the predictor that serves.
"""

import argparse
import sys
import timeit
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from benchmarks.push_predictions import choose
from service.errors import CazslError
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.pushing.mechanics import push
from service.pushing.onnx_interface import OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import FRICTION, ShapeContext
from training.networks.mechanics import PushMechanics
from training.publishing.onnx_export import export_module
from training.simulation.bodies import RECORDED
from training.simulation.replay import replay_even
from training.tables.push_table import PushTable
from training.tables.reading import read_table

MANY: Final = 1000
REPEATS: Final = 20


class ServedMechanics(nn.Module):
    """Mechanics as a graph of shapes. Its mean is the motion of the centroid in the push frame, in sizes."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.mechanics = PushMechanics(steps=steps)

    def forward(
        self, pusher: Tensor, silhouette: Tensor, outline: Tensor, support: Tensor, body: Tensor, context_index: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return mean, a std of 1, and zeros. The silhouette takes no part."""
        found = self.mechanics(pusher, outline, support, body, context_index)
        ignored = 0.0 * silhouette.mean(dim=(1, 2, 3))[context_index][:, None]
        return found.motion, 0.0 * found.motion + 1.0, torch.cat([ignored, ignored], dim=1)


def poses(motion: DoubleArray, table: PushTable) -> DoubleArray:
    """Return poses (n, 3) in the frame of the table, of motions of the centroid in the push frame, in sizes."""
    outlines = [table.objects[place].outline for place in table.object_index.tolist()]
    size, centroid = np.array([one.size_m for one in outlines]), np.array([one.centroid_m for one in outlines])
    angle = table.pushers[:, 2]
    moved = centroid + turned(motion[:, :2] * size[:, None], angle) - turned(centroid, motion[:, 2])
    return np.column_stack([moved, motion[:, 2]])


def turned(vectors: DoubleArray, angles_rad: DoubleArray) -> DoubleArray:
    """Return vectors (n, 2) turned by angles (n,)."""
    cos, sin = np.cos(angles_rad), np.sin(angles_rad)
    return np.stack([cos * vectors[:, 0] - sin * vectors[:, 1], sin * vectors[:, 0] + cos * vectors[:, 1]], axis=1)


def by_service(table: PushTable, steps: int) -> DoubleArray:
    """Return the poses (n, 3) that the mechanics of the service gives."""
    found = np.zeros((table.count, 3))
    for place, item in enumerate(table.objects):
        rows = table.object_index == place
        if rows.any():
            found[rows] = push(item.outline, table.pushers[rows], table.pusher_radius_m[rows], FRICTION, steps=steps)
    return found


def errors(found: DoubleArray, expected: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Return the distances (n,) in mm, and the differences of yaw in degrees."""
    apart = found - expected
    yaw = np.abs((apart[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    return np.hypot(apart[:, 0], apart[:, 1]) * 1e3, np.degrees(yaw)


def line(name: str, found: DoubleArray, table: PushTable, fine: DoubleArray, cost: str) -> str:
    """Return a line of the table."""
    distance, yaw = errors(found, table.outcomes)
    off, off_yaw = errors(found, fine)
    return (
        f"| {name} | {distance.mean():.2f} ({np.median(distance):.2f}) | {yaw.mean():.2f} ({np.median(yaw):.2f}) "
        f"| {off.mean():.3f}, {off_yaw.mean():.2f} | {cost} |"
    )


def by_graph(table: PushTable, steps: int) -> tuple[DoubleArray, str]:
    """Return the poses (n, 3) that a graph of some steps gives, and its operators and times."""
    graph = export_module(ServedMechanics(steps), ContextKind.SHAPE, OUTPUTS_WITH_UNFAMILIARITY)
    predictor = OnnxPredictor(graph, expected_inputs(ContextKind.SHAPE), OUTPUTS_WITH_UNFAMILIARITY)
    pairs, index = np.unique(
        np.column_stack([table.object_index, table.pusher_radius_m]), axis=0, return_inverse=True
    )  # of an object and a tip
    found = [
        ShapeContext(table.objects[int(place)].outline, pusher_radius_m=float(radius_m)).tensors()
        for place, radius_m in pairs
    ]
    contexts = tuple(map(np.stack, zip(*found, strict=True)))
    pushers = table.pushers.astype(np.float32)
    mean, *_ = predictor.predict(pushers, contexts, index.ravel().astype(np.int64))
    one = tuple(tensor[:1] for tensor in contexts)
    first = np.resize(pushers[table.object_index == table.object_index[0]], (MANY, 4))

    def seconds(count: int, number: int) -> float:
        """Return the lowest time of a call."""
        index = np.zeros(count, dtype=np.int64)
        times = timeit.repeat(lambda: predictor.predict(first[:count], one, index), number=number, repeat=REPEATS)
        return min(times) / number

    nodes = len(onnx.load_from_string(graph).graph.node)
    return mean.astype(np.float64), f"{nodes} | {seconds(1, 50) * 1e6:.0f} | {seconds(MANY, 2) * 1e3:.1f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.graph_mechanics",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="a table of pushes: a folder, or a file of pushes")
    parser.add_argument("--limit", type=int, default=1000, metavar="N", help="pushes, drawn with a fixed seed (1000)")
    parser.add_argument("--steps", type=int, nargs="+", default=[4, 6, 8], help="steps of the graphs (4 6 8)")
    options = parser.parse_args(arguments)
    try:
        table = choose(read_table(options.folder, None), [], options.limit)
    except CazslError as error:
        sys.exit(f"error: {error}")
    unknown = tuple(replace(item, centre_of_mass_m=None, friction=None) for item in table.objects)
    table = replace(table, objects=unknown)
    fine = replay_even(table, replace(RECORDED, plates=(), contact=FRICTION))
    print("| mechanics | mm, mean (median) | degrees | from the simulation | operators | one push, us | 1,000, ms |")
    print("|---|---|---|---|---|---|---|")
    print(line("simulation, even", fine, table, fine, "- | - | -"), flush=True)
    print(line("limit surface, 25 steps", by_service(table, 25), table, fine, "- | - | -"), flush=True)
    for steps in options.steps:
        motion, cost = by_graph(table, steps)
        print(line(f"graph, {steps} steps", poses(motion, table), table, fine, cost), flush=True)


if __name__ == "__main__":
    main()
