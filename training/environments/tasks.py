"""Tasks for planners: a drawn object, where it lies, and where it should be."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from service.pushing.poses import DoubleArray
from training.environments.tabletop import Tabletop
from training.shapes.objects import DrawnObject, draw_object

SIZES_M: Final = (0.05, 0.20)  # largest extents of objects that a hand would push
DISTANCES_M: Final = (0.05, 0.20)  # from start to goal
MOST_TURN_RAD: Final = np.pi / 2


@dataclass(frozen=True, eq=False)
class Task:
    """Task: bring an object from its start to a goal, both (3,) x_m, y_m, yaw_rad in the world, angles as drawn."""

    drawn: DrawnObject
    start: DoubleArray
    goal: DoubleArray
    seed: int
    """Of the table: how the weight is spread, and the friction under each push."""

    def tabletop(self) -> Tabletop:
        """Put the object on a table, at the start. Every call gives the same table.

        Raises:
            ValueError: no support under the object balances at its centre of mass.
        """
        return Tabletop(
            self.drawn.outline,
            self.start,
            self.seed,
            centre_of_mass_m=self.drawn.centre_of_mass_m,
            friction=self.drawn.friction,
            pusher_radius_m=self.drawn.pusher_radius_m,
        )


def draw_tasks(families: Sequence[str], count: int, seed: int = 0) -> list[Task]:
    """Draw tasks with objects of families in turn, such as those that a model never saw.

    A task does not depend on how many are drawn.
    """
    return [
        draw_task(families[number % len(families)], np.random.default_rng([seed, number])) for number in range(count)
    ]


def draw_task(family: str, rng: np.random.Generator) -> Task:
    """Draw a task with an object of a family.

    Objects, their weight, friction and pusher are those of ``training.shapes.objects``, 50 to 200 mm across. The start
    is any pose within 0.1 m of the origin along each axis. For the goal see ``draw_pose``.
    """
    while True:
        drawn = draw_object(family, rng)
        if SIZES_M[0] <= drawn.outline.extent_m <= SIZES_M[1]:
            start = rng.uniform((-0.1, -0.1, -np.pi), (0.1, 0.1, np.pi))
            task = Task(drawn, start, draw_pose(start, rng), int(rng.integers(2**31)))
            with suppress(ValueError):  # of 10,000 objects about one, whose feet do not surround a heavy end
                task.tabletop()
                return task


def draw_pose(near: DoubleArray, rng: np.random.Generator) -> DoubleArray:
    """Draw a pose (3,) that is 50 to 200 mm from another in any direction, and turned by at most 90 degrees."""
    distance_m, bearing = rng.uniform(*DISTANCES_M), rng.uniform(-np.pi, np.pi)
    turn = rng.uniform(-MOST_TURN_RAD, MOST_TURN_RAD)
    away = np.array([distance_m * np.cos(bearing), distance_m * np.sin(bearing), turn])
    return np.asarray(near + away)
