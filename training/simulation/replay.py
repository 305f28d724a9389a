"""Replay of a table of pushes by the simulation: its outcomes of the same pushes, with one set of constants for all."""

import zlib
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from service.errors import DataError
from training.simulation.bodies import RECORDED, Body, Physics, body, draw_body, even_conditions
from training.simulation.pushing import push_body, simulate_pushes
from training.simulation.surfaces import Array
from training.tables.push_table import PushTable, TableObject


def replay(table: PushTable, seed: int, draws: int, physics: Physics = RECORDED) -> Array:
    """Simulate the pushes of a table, (draws, n, 3): x_m, y_m, yaw_rad.

    Each draw has conditions of its own for every push. On a surface that ``physics.plates`` names, the weight of an
    object is spread in that way. On any other, the way is drawn for each object and draw. Known centres of mass and
    contact frictions are used.

    Raises:
        DataError: an object has a centre of mass that no support under it could balance.
    """
    found = np.empty((draws, len(table.pushers), 3))
    for item, surface, rows in _groups(table):
        for draw in range(draws):
            name = f"{item.name} on {surface}"
            rng = np.random.default_rng([seed, draw, zlib.crc32(name.encode())])
            pushed = _body(item, dict(physics.plates).get(surface), physics, rng)
            found[draw, rows] = simulate_pushes(
                pushed, table.pushers[rows], table.pusher_radius_m[rows], physics.of(item.friction), rng
            )
    return found


def replay_even(table: PushTable, physics: Physics = RECORDED, step_m: float | None = None) -> Array:
    """Simulate the pushes of a table without any variation, (n, 3). On an unknown plate the pressure is even."""
    found = np.empty((len(table.pushers), 3))
    for item, surface, rows in _groups(table):
        pushed = _body(item, dict(physics.plates).get(surface, "even"), physics, np.random.default_rng(0))
        conditions = even_conditions(pushed, len(rows), physics.of(item.friction).contact)
        found[rows] = push_body(pushed, table.pushers[rows], table.pusher_radius_m[rows], conditions, step_m)
    return found


def _body(item: TableObject, spread: str | None, physics: Physics, rng: np.random.Generator) -> Body:
    """Return the body of an object, with its weight spread in a known way, or in a drawn one."""
    centre = None if item.centre_of_mass_m is None else np.array(item.centre_of_mass_m)
    try:
        if spread is None:
            return draw_body(item.outline, physics, rng, centre)
        return body(item.outline, spread, rng, centre)
    except ValueError as error:
        raise DataError(f"object {item.name!r} cannot be simulated: {error}; correct it, or leave it empty") from error


def _groups(table: PushTable) -> Iterator[tuple[TableObject, str, npt.NDArray[np.intp]]]:
    """Yield each object on each surface with its rows."""
    for number, item in enumerate(table.objects):
        for place, surface in enumerate(table.surfaces):
            rows = np.flatnonzero((table.object_index == number) & (table.surface_index == place))
            if len(rows):
                yield item, surface, rows
