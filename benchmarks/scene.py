"""Simulation of pushes held against recorded ones: errors, scatter of repeats, time step and speed.

    python -m benchmarks.scene FOLDER [--rows N] [--draws 8] [--search] [--mujoco 20] [--out FILE]

FOLDER is a table of recorded pushes (docs/data.md). The constants of ``training.simulation.bodies.RECORDED`` are chosen
on the pushes whose starts lie in every other sector of 3 degrees about an object, and reported on the rest, too. Errors
are those of the scene without variation, as the tips were tracked and with all tips moved until they touch, and of the
mean of a few draws. Scatter is that of pushes from the same start,
on the same plate: recorded, and in the scene, where each push draws its own conditions.

With --search, a coarse grid around the constants is tried: contact friction and pressure by the error on the chosen
part, then the constants of the variation by the scatter of repeats. With --mujoco, as many pushes of each object are
simulated in MuJoCo, on the same feet.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mujoco import rollout

from benchmarks.push_measures import Repeats, difference, repeats
from service.errors import CazslError
from service.pushing.poses import DoubleArray
from service.storage.disk import replace_whole
from training.simulation.bodies import RECORDED, Physics, body
from training.simulation.pieces import convex_pieces
from training.simulation.pushing import STEP_M
from training.simulation.replay import replay, replay_even
from training.simulation.scene import push_object
from training.simulation.solids import Solid
from training.simulation.surfaces import even_conditions
from training.tables.push_table import IndexArray, PushTable
from training.tables.reading import read_table

SECTOR_DEG = 3.0
GOAL = (3.7, 4.5)  # mean errors: mm, degrees
REPEATS_GOAL = (1.41, 1.34, 2.49, 3.09)  # median mm, degrees, mean mm, degrees, within 20 %
CORES = 2

Mask = npt.NDArray[np.bool_]
Errors = tuple[DoubleArray, DoubleArray]  # (n,) mm and degrees


def errors(outcomes: DoubleArray, found: DoubleArray) -> Errors:
    """Return distances in mm and absolute turns in degrees between poses (n, 3)."""
    apart = difference(outcomes, found)
    return 1e3 * np.hypot(apart[:, 0], apart[:, 1]), np.degrees(np.abs(apart[:, 2]))


def chosen_part(table: PushTable) -> Mask:
    """Return (n,) true for the pushes that constants are chosen on: starts in every other sector about their object."""
    centres = np.array([item.outline.centroid_m for item in table.objects])[table.object_index]
    x, y = (table.pushers[:, :2] - centres).T
    return np.asarray(np.floor(np.degrees(np.arctan2(y, x)) / SECTOR_DEG) % 2 == 0)


def touching(table: PushTable) -> PushTable:
    """Return a table whose tips start in touch with the outline, at the nearest place."""
    pushers = table.pushers.copy()
    for number, item in enumerate(table.objects):
        rows = table.object_index == number
        nearest = item.outline.nearest(pushers[rows, :2])
        gap = nearest.distance_m - table.pusher_radius_m[rows]
        pushers[rows, :2] += gap[:, None] * nearest.normal
    return replace(table, pushers=pushers)


def spread(found: Repeats | None) -> tuple[float, ...]:
    """Return median and mean distances of repeats: median mm, degrees, mean mm, degrees."""
    if found is None:
        return (0.0,) * 4
    return found.position_mm.median, found.yaw_deg.median, found.position_mm.mean, found.yaw_deg.mean


def cell(found: Errors, rows: Mask | IndexArray) -> str:
    """Return mean and median of errors as a cell of a table."""
    mm, deg = (values[rows] for values in found)
    return f"{mm.mean():.2f} ({np.median(mm):.2f}) | {deg.mean():.2f} ({np.median(deg):.2f})"


def error_table(table: PushTable, even: DoubleArray, drawn: DoubleArray) -> list[str]:
    """Return the errors of the scene and of the table's peers, per part, shape and surface."""
    models = {
        "scene": even,
        "from touch": replay_even(touching(table)),
        f"mean of {len(drawn)} draws": drawn.mean(axis=0),
        **table.peers,
    }
    found = {name: errors(table.outcomes, outcome) for name, outcome in models.items()}
    part = chosen_part(table)
    groups = {"all": np.full(len(part), True), "chosen on": part, "the rest": ~part}
    for surface, name in enumerate(table.surfaces):
        groups[name] = table.surface_index == surface
    for item, surface in itertools.product(range(len(table.objects)), range(len(table.surfaces))):
        rows = (table.object_index == item) & (table.surface_index == surface)
        groups[f"{table.objects[item].name}, {table.surfaces[surface]}"] = rows
    head = " | ".join(f"{name}, mm | degrees" for name in models)
    lines = [f"| pushes | rows | {head} |", "|---|---|" + "---|---|" * len(models)]
    for name, rows in groups.items():
        if rows.any():
            lines.append(f"| {name} | {rows.sum()} | " + " | ".join(cell(each, rows) for each in found.values()) + " |")
    shapes = [np.flatnonzero(table.object_index == item) for item in range(len(table.objects))]
    means = [
        " | ".join(f"{np.mean([values[rows].mean() for rows in shapes]):.2f}" for values in each)
        for each in found.values()
    ]
    return [*lines, f"| mean of the means of the shapes | {len(shapes)} shapes | " + " | ".join(means) + " |"]


def scatter_table(table: PushTable, drawn: DoubleArray) -> list[str]:
    """Return the scatter of pushes from the same start, recorded and simulated."""
    lines = ["| repeats on one plate | pairs | median mm | degrees | mean mm | degrees |", "|---|---|---|---|---|---|"]
    recorded = repeats(table)[0]
    if recorded is None:
        return []
    rows = {"recorded": spread(recorded)}
    rows["scene"] = tuple(np.mean([spread(repeats(replace(table, outcomes=one))[0]) for one in drawn], axis=0))
    rows["goal, within 20 %"] = REPEATS_GOAL
    return lines + [
        f"| {name} | {recorded.pairs} | " + " | ".join(f"{value:.2f}" for value in values) + " |"
        for name, values in rows.items()
    ]


def step_lines(table: PushTable, even: DoubleArray) -> list[str]:
    """Return the error of the step: against a quarter of it and more iterations."""
    fine = replay_even(table, step_m=STEP_M / 4)
    mm, deg = errors(fine, even)
    worst = f"95 % below {np.quantile(mm, 0.95):.2f} mm and {np.quantile(deg, 0.95):.2f} degrees"
    return [f"Step {STEP_M * 1e3:g} mm against a quarter of it: {mm.mean():.3f} mm, {deg.mean():.3f} degrees, {worst}."]


def mujoco_table(table: PushTable, count: int) -> list[str]:
    """Return errors and cost of the MuJoCo scene on the same feet, beside those of the quasi-static one."""
    rows = np.concatenate(
        [np.flatnonzero(table.object_index == item)[:: max(1, (table.object_index == item).sum() // count)][:count]
         for item in range(len(table.objects))]
    )  # fmt: skip
    few = replace(table.select(rows), surfaces=("",), surface_index=np.zeros(len(rows), dtype=np.int64))
    ways: dict[str, Callable[[PushTable], DoubleArray]] = {
        "quasi-static": replay_even,
        "MuJoCo, 4 ms": partial(in_mujoco, step_s=0.004),
        "MuJoCo, 1 ms": partial(in_mujoco, step_s=0.001),
    }
    found = {}
    for name, way in ways.items():
        start = time.process_time()
        outcome = way(few)
        found[name] = outcome, time.process_time() - start
    quasi = found["quasi-static"][0]
    lines = [f"| {len(rows)} pushes on even feet | from the recordings | | from quasi-static | | ms a push |"]
    lines += ["|---|---|---|---|---|---|"]
    everything = np.arange(len(rows))
    for name, (outcome, spent) in found.items():
        both = f"{cell(errors(few.outcomes, outcome), everything)} | {cell(errors(quasi, outcome), everything)}"
        lines.append(f"| {name} | {both} | {1e3 * spent / len(rows):.2f} |")
    return lines


def in_mujoco(table: PushTable, step_s: float) -> DoubleArray:
    """Simulate pushes of a table in MuJoCo, without variation, (n, 3). All are taken to be 50 mm long."""
    found = np.empty((len(table.pushers), 3))
    with rollout.Rollout(nthread=0) as pool:
        for number, item in enumerate(table.objects):
            rows = np.flatnonzero(table.object_index == number)
            feet = body(item.outline, "even", np.random.default_rng(0)).feet_m
            solid = Solid(convex_pieces(item.outline), (), tuple((float(x), float(y)) for x, y in feet))
            conditions = replace(even_conditions(len(rows)), contact=np.full(len(rows), RECORDED.contact))
            found[rows] = push_object(solid, table.pushers[rows, :3], conditions, pool, 1, step_s)
    return found


def search(table: PushTable) -> None:
    """Try constants around the chosen ones on the chosen part, best last."""
    part = table.select(chosen_part(table))
    tried: list[tuple[float, str]] = []
    ways = ("even", "rim")
    for contact, plates in itertools.product((0.14, 0.17, 0.2, 0.23, 0.26), itertools.product(ways, ways)):
        physics = replace(RECORDED, contact=contact, plates=tuple(zip(("abs", "plywood"), plates, strict=True)))
        mm, deg = (each.mean() for each in errors(part.outcomes, replay_even(part, physics)))
        tried.append(
            (mm / GOAL[0] + deg / GOAL[1], f"contact {contact:.2f}, plates {plates}: {mm:.2f} mm, {deg:.2f} deg")
        )
    for _, text in sorted(tried, reverse=True):
        print(text)
    tried = []
    for roughness, varies, contact in itertools.product((0.3, 0.4, 0.47, 0.55), (0.0, 0.3, 0.5, 0.7), (0.0, 0.05, 0.1)):
        physics = replace(RECORDED, roughness=roughness, roughness_spread=varies, contact_spread=contact)
        values = scatter_of(part, physics)
        worst = max(abs(value / goal - 1.0) for value, goal in zip(values, REPEATS_GOAL, strict=True))
        shown = " ".join(f"{value:.2f}" for value in values)
        tried.append(
            (worst, f"roughness {roughness}, its spread {varies}, contact {contact}: {shown}, off {worst:.0%}")
        )
    for _, text in sorted(tried, reverse=True):
        print(text)


def scatter_of(table: PushTable, physics: Physics) -> tuple[float, ...]:
    """Return the scatter of repeats in one draw of the scene."""
    return spread(repeats(replace(table, outcomes=replay(table, 0, 1, physics)[0]))[0])


def report(table: PushTable, draws: int, mujoco: int) -> list[str]:
    """Return the report, a line each."""
    even = replay_even(table)
    start = time.process_time()
    drawn = replay(table, 0, draws)
    spent = time.process_time() - start
    lines = [*error_table(table, even, drawn), "", *scatter_table(table, drawn), "", *step_lines(table, even)]
    rate = CORES * draws * len(table.pushers) / spent
    lines += ["", f"{rate:,.0f} pushes a second on {CORES} cores, of processor time, with drawn conditions."]
    return [*lines, "", *mujoco_table(table, mujoco)] if mujoco else lines


def heading(table: PushTable, options: argparse.Namespace) -> list[str]:
    """Return the opening of the written report: the command and the table."""
    rows = f"--rows {options.rows} " if options.rows else ""
    command = f"python -m benchmarks.scene FOLDER {rows}--draws {options.draws} --mujoco {options.mujoco}"
    about = f"{len(table.pushers):,} pushes of {len(table.objects)} objects (digest {table.digest[:8]}...)"
    return ["# Figures of the simulation", "", f"`{command}`, on {about}. Means, and medians in brackets.", ""]


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the table, search or report."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scene",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="a table of recorded pushes")
    parser.add_argument("--rows", type=int, metavar="N", help="take N pushes, evenly spaced in the file")
    parser.add_argument("--draws", type=int, default=8, help="draws of the conditions of every push")
    parser.add_argument("--search", action="store_true", help="try other constants instead of the report")
    parser.add_argument("--mujoco", type=int, default=0, metavar="N", help="compare N pushes an object with MuJoCo")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the report into this file, too")
    options = parser.parse_args(arguments)
    try:
        table = read_table(options.folder)
        if options.rows:
            table = table.select(np.linspace(0, len(table.pushers) - 1, options.rows).astype(np.int64))
        if options.search:
            search(table)
            return
        lines = report(table, options.draws, options.mujoco)
        print("\n".join(lines))
        if options.out:
            replace_whole(options.out, ("\n".join([*heading(table, options), *lines]) + "\n").encode())
    except CazslError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
