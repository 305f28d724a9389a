"""Simulated pushes of drawn objects, as a table of pushes.

An object's name, such as ``hammer-12``, and the seed decide the object and its pushes. So the table does not depend on
the number of jobs or on interruptions, and families that are held out do not change the other objects. The pushes of
each object are kept in a file of their own below ``parts`` until the table is written, so that a run that was killed
continues where it stopped.
"""

import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from tqdm import tqdm

from service.bulk.executors import Executor
from service.errors import DataError
from training.omnipush.declaration import DATASET_FILE, declare_dataset
from training.omnipush.npy_files import NpyKind, parse_npy, read_content, write_npy, writing
from training.shapes.families import FAMILIES
from training.shapes.objects import DrawnObject, draw_object
from training.simulation.approach import Approach, draw_pushers
from training.simulation.bodies import ANY_PLATE, Body, Physics, draw_body
from training.simulation.exact import Array, exp
from training.simulation.pushing import ITERATIONS, STEP_M, STEPS_A_RADIUS, STEPS_A_SIZE, simulate_pushes
from training.tables.files import MAX_PUSHES, is_table
from training.tables.push_table import PushTable, TableObject, TextColumn
from training.tables.writing import write_table

PUSH_LENGTHS_M: Final = (0.005, 0.120)
ANYWHERE: Final = Approach(miss_share=0.1, central_share=0.0)
PARTS: Final = "parts"
SURFACE: Final = "simulated"  # friction of a plate moves quasi-static objects alike, so it has no other name
_MICRO: Final = 6  # decimals of lengths
_PUSHER: Final = 4  # columns of a part, before those of the outcome
_COLUMNS: Final = 7


@dataclass(frozen=True)
class ShapePlan:
    """Table to simulate: the number of objects, spread evenly over families, and how they are pushed."""

    objects: int = 4000
    pushes: int = 200
    """For each object."""
    seed: int = 0
    families: tuple[str, ...] = tuple(FAMILIES)
    approach: Approach = ANYWHERE
    physics: Physics = ANY_PLATE

    def __post_init__(self) -> None:
        """Refuse a table that is too large to be one.

        Raises:
            DataError: there are more pushes than a table may have.
        """
        if self.objects * self.pushes > MAX_PUSHES:
            raise DataError(
                f"{self.objects} objects of {self.pushes} pushes are more than the {MAX_PUSHES} pushes of a table; "
                "name fewer, or simulate several tables with different seeds"
            )

    @property
    def names(self) -> list[tuple[str, int]]:
        """Family and number of every object."""
        count = len(self.families)
        return [(self.families[index % count], index // count) for index in range(self.objects)]

    def declaration(self) -> dict[str, Any]:
        """Return the content of the table's ``dataset.json``."""
        return {
            "source": f"simulated pushes of drawn shapes (quasi-static, seed {self.seed})",
            "simulated": True,
            "seed": self.seed,
            "objects": self.objects,
            "pushes_per_object": self.pushes,
            "families": list(self.families),
            "push_lengths_m": list(PUSH_LENGTHS_M),
            "approach": asdict(self.approach),
            "physics": {**asdict(self.physics), "contact": "that of the object"},
            "steps": {
                "longest_m": STEP_M,
                "a_size": STEPS_A_SIZE,
                "a_radius": STEPS_A_RADIUS,
                "iterations": ITERATIONS,
            },
            "geos": shapely.geos_version_string,
        }


@dataclass(frozen=True)
class PushedObject:
    """Object and its simulated pushes."""

    drawn: DrawnObject
    pushers: Array
    """(n, 4), x_m, y_m, angle_rad, length_m."""
    outcomes: Array
    """(n, 3), x_m, y_m, yaw_rad."""


def simulate_shapes(plan: ShapePlan, folder: Path, executor: Executor, quiet: bool = False) -> int:
    """Simulate the table of a plan into a folder, or the rest of it.

    Returns:
        The number of pushes simulated. It is 0 if the table is there already.

    Raises:
        DataError: the folder holds other data, or cannot be written.
        WorkforceError: a worker of the executor was lost.
    """
    if is_table(folder) and not (folder / DATASET_FILE).is_file():
        raise DataError(f"{folder} holds a table of other pushes; give an empty folder")
    declare_dataset(folder, plan.declaration())
    parts = folder / PARTS
    simulated = 0
    if not is_table(folder):
        with writing(parts):
            parts.mkdir(exist_ok=True)
        missing = sum(not _part(parts, *name).is_file() for name in plan.names)
        pushed = list(_simulated(plan, parts, executor, quiet))
        write_table(folder, shape_table(plan, pushed), declaration=plan.declaration())
        simulated = missing * plan.pushes
    if parts.is_dir():
        with writing(parts):
            shutil.rmtree(parts)
    return simulated


def draw_named(plan: ShapePlan, family: str, number: int) -> tuple[DrawnObject, Body, np.random.Generator]:
    """Draw an object and how its weight is spread, from its name and the seed. The generator draws its pushes."""
    rng = np.random.default_rng([plan.seed, *f"shape {_name(family, number)}".encode()])
    while True:
        drawn = draw_object(family, rng)
        with suppress(ValueError):  # of 10,000 objects about one, whose feet do not surround a heavy end
            return drawn, draw_body(drawn.outline, plan.physics, rng, np.array(drawn.centre_of_mass_m)), rng


def push_named(plan: ShapePlan, family: str, number: int) -> PushedObject:
    """Draw an object and simulate its pushes."""
    drawn, body, rng = draw_named(plan, family, number)
    low, high = (math.log(limit) for limit in PUSH_LENGTHS_M)
    lengths_m = np.round(exp(rng.uniform(low, high, plan.pushes)), _MICRO)
    pushers = draw_pushers(drawn.outline, lengths_m, drawn.pusher_radius_m, rng, plan.approach)
    physics = replace(plan.physics, contact=drawn.friction)
    return PushedObject(drawn, pushers, simulate_pushes(body, pushers, drawn.pusher_radius_m, physics, rng))


def shape_table(plan: ShapePlan, pushed: list[PushedObject]) -> PushTable:
    """Return the table of the objects of a plan, with their families as a column to split by."""
    objects = tuple(
        TableObject(
            _name(*name), item.drawn.outline, item.drawn.centre_of_mass_m, item.drawn.mass_kg, item.drawn.friction
        )
        for name, item in zip(plan.names, pushed, strict=True)
    )
    counts = [len(item.pushers) for item in pushed]
    families = np.array([plan.families.index(item.drawn.family) for item in pushed])
    return PushTable(
        objects=objects,
        object_index=np.repeat(np.arange(len(pushed)), counts),
        pushers=np.concatenate([item.pushers for item in pushed]),
        outcomes=np.concatenate([item.outcomes for item in pushed]),
        pusher_radius_m=np.repeat([item.drawn.pusher_radius_m for item in pushed], counts),
        surfaces=(SURFACE,),
        surface_index=np.zeros(sum(counts), dtype=np.int64),
        source=str(plan.declaration()["source"]),
        digest="",
        labels={"family": TextColumn(plan.families, np.repeat(families, counts))},
    )


def _simulated(plan: ShapePlan, parts: Path, executor: Executor, quiet: bool) -> Iterator[PushedObject]:
    """Yield the objects of a plan with their pushes, in order, from their parts or simulated."""
    total = plan.objects * plan.pushes
    with (
        executor.start(_worker, (plan, parts)) as pool,
        tqdm(total=total, desc="pushing", unit="push", unit_scale=True, disable=quiet) as progress,
    ):
        for item in pool.in_order(plan.names):
            yield item
            progress.update(plan.pushes)


def _worker(shared: tuple[ShapePlan, Path]) -> Callable[[tuple[str, int]], PushedObject]:
    return partial(_push_or_read, *shared)


def _push_or_read(plan: ShapePlan, parts: Path, name: tuple[str, int]) -> PushedObject:
    """Return an object with its pushes: as they were kept, or simulated and kept."""
    path = _part(parts, *name)
    if path.is_file():
        rows = _read_part(path, plan.pushes)
        return PushedObject(draw_named(plan, *name)[0], rows[:, :_PUSHER], rows[:, _PUSHER:])
    pushed = push_named(plan, *name)
    write_npy(path, np.column_stack([pushed.pushers, pushed.outcomes]))
    return pushed


def _read_part(path: Path, pushes: int) -> Array:
    kind = NpyKind(pushes * _COLUMNS * 8 + 1024, f"{pushes} pushes of an object", "remove it, and start again")
    rows = parse_npy(path, read_content(path, kind), kind)
    if rows.shape != (pushes, _COLUMNS) or rows.dtype != np.float64 or not np.isfinite(rows).all():
        raise DataError(f"{path} is not the pushes of an object, [{pushes}, {_COLUMNS}]; {kind.remedy}")
    return rows


def _part(parts: Path, family: str, number: int) -> Path:
    return parts / f"{_name(family, number)}.npy"


def _name(family: str, number: int) -> str:
    return f"{family}-{number}"
