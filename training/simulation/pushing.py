"""Pushing any body on a plate: quasi-static sliding on many feet, for many pushes at once.

Every foot carries its load and slides with Coulomb friction. The pusher is a round rod that moves in a straight line,
whatever it meets. At 10 to 40 mm/s inertia is far below friction, so each small step of the rod asks for the motion of
the object whose friction on all feet balances the force of the contact. That force lies within the friction cone and
keeps the rod out of the outline.

Friction is linearised about the motion of the last iteration: a foot that moves at a speed v resists like a damper of
load over v (iteratively reweighted least squares, the majorisation of Weiszfeld). For dampers the contact has a closed
form: it sticks, or it slides on the edge of its cone. A few iterations a step are enough, as motion changes little from
step to step. In a concave corner the rod may touch two edges, whose forces are found in turns (Gauss and Seidel).

The frame is the object's throughout: the feet stay, and the rod moves and turns around them. Only sums, products,
quotients, roots and ``exact`` are used, so that every processor computes the same bytes. Arrays have pushes last.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from training.simulation.bodies import Body, Conditions, Physics, draw_conditions
from training.simulation.exact import atan2, cos, directions, sin
from training.simulation.surfaces import Array

Rows = npt.NDArray[np.int64]

# Travel of the rod in one step: costs 0.1 mm and 0.1 degrees on average, see docs/results/scene
STEP_M: Final = 0.001
STEPS_A_SIZE: Final = 30  # at least, for a travel as long as the object's size (root mean square radius)
STEPS_A_RADIUS: Final = 3  # likewise, for the rod's radius
MOST_STEPS: Final = 10_000  # of a push. A longer one has longer steps
ITERATIONS: Final = 2  # of each step
_REST: Final = 0.02  # share of a step: a foot that moves less is held by less than its whole friction
_CORNER: Final = 0.9  # cosine between the normals of two contacts that count as two
_TOGETHER: Final = 1024  # pushes at a time: their arrays stay in the cache of a processor
_SWEEPS: Final = 6  # over two contacts in turns
_LEAST_M: Final = 1e-9


def simulate_pushes(
    body: Body, pushers: Array, pusher_radius_m: npt.ArrayLike, physics: Physics, rng: np.random.Generator
) -> Array:
    """Simulate pushes of one body with conditions drawn for each, as a tracker records them, (n, 3).

    The arguments are those of ``push_body``, with the physical constants and the generator of all random numbers.
    """
    conditions = draw_conditions(body, physics, len(pushers), rng)
    outcomes = push_body(body, pushers, pusher_radius_m, conditions)
    readings = rng.normal(size=(2, *outcomes.shape)) * physics.tracker_std  # before and after the push
    return np.asarray(outcomes + readings[1] - readings[0])


def push_body(
    body: Body,
    pushers: Array,
    pusher_radius_m: npt.ArrayLike,
    conditions: Conditions,
    step_m: float | None = None,
    iterations: int = ITERATIONS,
) -> Array:
    """Simulate pushes of one body.

    Args:
        body: the object, in the frame of its outline.
        pushers: (n, 4): x_m, y_m, angle_rad, length_m of each push. A rod that starts inside of the outline is moved
            out along the nearest normal.
        pusher_radius_m: radius of the rod, one for all or (n,).
        conditions: of every push.
        step_m: travel of the rod in one step, by default ``STEP_M``, or less for a small object or rod.
        iterations: of each step.

    Returns:
        The pose after each push, (n, 3): x_m, y_m, yaw_rad, in the frame of the outline before it.
    """
    radius_m = np.broadcast_to(np.asarray(pusher_radius_m, dtype=np.float64), len(pushers))
    if len(pushers) > _TOGETHER:
        parts = [slice(first, first + _TOGETHER) for first in range(0, len(pushers), _TOGETHER)]
        drawn = [(pushers[part], radius_m[part], conditions.select(part)) for part in parts]
        return np.concatenate([push_body(body, *part, step_m, iterations) for part in drawn])
    longest = np.minimum(min(STEP_M, body.outline.size_m / STEPS_A_SIZE), radius_m / STEPS_A_RADIUS)
    # pushes in the order of their steps, so that those that are still on come first
    seen = _placed(pushers, conditions.misplaced)
    place, heading, left = _approach(body.outline, seen, radius_m)
    steps = np.minimum(np.ceil(left / (longest if step_m is None else step_m)), MOST_STEPS).astype(np.int64)
    order = np.argsort(-steps, kind="stable")
    state = _State(body, place[:, order], heading[:, order], conditions, order, radius_m[order])
    travel = left[order] / np.maximum(steps[order], 1)
    for done in range(int(steps.max(initial=0))):
        state.advance(int((steps > done).sum()), travel, iterations)
    found = np.empty((len(pushers), 3))
    found[order] = state.poses(body.centre_of_mass_m)
    return _recorded(found, conditions.misplaced)


class _State:
    """Poses, motions and rods of all pushes of a body; its own origin is the centre of mass."""

    def __init__(
        self, body: Body, place: Array, heading: Array, conditions: Conditions, order: Rows, radius_m: Array
    ) -> None:
        origin = body.centre_of_mass_m
        self._feet_x, self._feet_y = (body.feet_m - origin).T[:, :, None]
        self._square = self._feet_x**2 + self._feet_y**2
        self._loads = conditions.loads[:, order]
        self._contact = conditions.contact[order]
        self._edges = _Edges(body.outline, origin)
        self._radius_m = radius_m
        self._rod = place - origin[:, None]
        self._heading = heading
        count = len(order)
        self._centre = np.zeros((2, count))
        self._turn = np.stack([np.ones(count), np.zeros(count)])  # cosine and sine of the yaw
        self._motion = np.zeros((3, count))  # of the last step

    def advance(self, count: int, travel: Array, iterations: int) -> None:
        """Move the first ``count`` rods by one step, and the objects that they push."""
        rod, heading, travel = self._rod[:, :count], self._heading[:, :count], travel[:count]
        step = heading * travel
        first, second = self._edges.contacts(rod, self._radius_m[:count])
        motion = np.zeros((3, count))
        pushed = np.flatnonzero(_closing(first, step) > 0.0)
        if len(pushed):
            motion[:, pushed] = self._solve(pushed, first, second, step, travel, iterations)
        self._motion[:, :count] = motion
        # Cayley's map of the turn: rational, and within 1e-6 of the turn itself for a step
        half = motion[2] / 2.0
        cos, sin = (1.0 - half * half) / (1.0 + half * half), 2.0 * half / (1.0 + half * half)
        turn = self._turn[:, :count]
        self._centre[:, :count] += _rotated(motion[:2], turn[0], turn[1])
        self._turn[:, :count] = _rotated(turn, cos, sin)
        self._rod[:, :count] = _rotated(rod + step - motion[:2], cos, -sin)
        self._heading[:, :count] = _rotated(heading, cos, -sin)

    def poses(self, origin: Array) -> Array:
        """Return the poses of the frame whose origin was at minus the centre of mass, (n, 3)."""
        yaw = atan2(self._turn[1], self._turn[0])
        moved = self._centre + origin[:, None] - _rotated(np.repeat(origin[:, None], len(yaw), 1), *self._turn)
        return np.column_stack([*moved, yaw])

    def _solve(
        self, rows: Rows, first: Array, second: Array | None, step: Array, travel: Array, iterations: int
    ) -> Array:
        """Return the motions (3, m) of the pushes ``rows``: x_m, y_m, yaw_rad of the centre of mass."""
        loads, contact, step, travel = self._loads[:, rows], self._contact[rows], step[:, rows], travel[rows]
        first, second = first[:, rows], second if second is None else second[:, rows]
        motion = self._motion[:, rows]
        fresh = (motion[0] == 0.0) & (motion[1] == 0.0) & (motion[2] == 0.0)
        motion = np.where(fresh, np.stack([step[0], step[1], np.zeros(len(rows))]), motion)
        rest = (_REST * travel) ** 2
        for _ in range(iterations):
            across = motion[0] - motion[2] * self._feet_y
            along = motion[1] + motion[2] * self._feet_x
            damping = loads / np.sqrt(across * across + along * along + rest)
            total = _sum(damping)
            x, y = _sum(damping * self._feet_x) / total, _sum(damping * self._feet_y) / total
            inertia = _sum(damping * self._square) - total * (x * x + y * y)
            middle = np.stack([x, y])
            motion = _contact_motion(total, middle, inertia, [first], step, contact)
            if second is not None:  # few rods would enter a second edge
                two = np.flatnonzero(_closing(second, step - _motion_at(second, motion)) > 0.0)
                if len(two):
                    both = [first[:, two], second[:, two]]
                    motion[:, two] = _contact_motion(
                        total[two], middle[:, two], inertia[two], both, step[:, two], contact[two]
                    )
        return motion


def _contact_motion(
    total: Array, middle: Array, inertia: Array, touches: list[Array], step: Array, contact: Array
) -> Array:
    """Return the motion (3, m) of bodies on dampers that rods push by a step, at one or two contacts.

    Args:
        total: (m,) sum of the dampers.
        middle: (2, m) their middle.
        inertia: (m,) their second moment about it.
        touches: contacts (5, m): place, inward normal, gap.
        step: (2, m) of the rods.
        contact: (m,) coefficients of friction.
    """
    velocity, spin = np.zeros_like(step), np.zeros_like(total)
    normals, tangents = [np.zeros_like(total) for _ in touches], [np.zeros_like(total) for _ in touches]
    for _ in range(_SWEEPS if len(touches) > 1 else 1):
        for number, (x, y, nx, ny, gap) in enumerate(touches):
            ax, ay = x - middle[0], y - middle[1]
            arm_n, arm_t = ax * ny - ay * nx, ax * nx + ay * ny  # of the normal, and of the tangent (-ny, nx)
            nn, tt = 1.0 / total + arm_n * arm_n / inertia, 1.0 / total + arm_t * arm_t / inertia
            nt = arm_n * arm_t / inertia
            force, drag = normals[number], tangents[number]
            # motion of the contact that the other forces leave to this one
            wanted = nx * step[0] + ny * step[1] - gap - (nx * velocity[0] + ny * velocity[1] + arm_n * spin)
            slip = nx * step[1] - ny * step[0] - (nx * velocity[1] - ny * velocity[0] + arm_t * spin)
            wanted, slip = wanted + nn * force + nt * drag, slip + nt * force + tt * drag
            determinant = nn * tt - nt * nt
            stick_n, stick_t = (tt * wanted - nt * slip) / determinant, (nn * slip - nt * wanted) / determinant
            side = np.where(stick_t > 0.0, contact, -contact)
            pressed = np.maximum(wanted / np.maximum(nn + side * nt, 1e-3 * nn), 0.0)
            sticks = (stick_n > 0.0) & (np.abs(stick_t) <= contact * stick_n)
            normals[number] = np.where(sticks, stick_n, pressed)
            tangents[number] = np.where(sticks, stick_t, side * pressed)
            more_n, more_t = normals[number] - force, tangents[number] - drag
            velocity = velocity + np.stack([nx * more_n - ny * more_t, ny * more_n + nx * more_t]) / total
            spin = spin + (arm_n * more_n + arm_t * more_t) / inertia
    return np.stack([velocity[0] + spin * middle[1], velocity[1] - spin * middle[0], spin])


class _Edges:
    """Edges of an outline about an origin, and the contacts of rods with them."""

    def __init__(self, outline: Outline, origin: Array) -> None:
        start, edge = outline.corners - origin, outline.edges
        self._x, self._y = start.T[:, :, None]
        self._dx, self._dy = edge.T[:, :, None]
        self._square = self._dx**2 + self._dy**2
        following = np.roll(edge, -1, axis=0)
        self._convex = bool((edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0] >= 0.0).all())

    def contacts(self, rods: Array, radius_m: Array) -> tuple[Array, Array | None]:
        """Return the nearest contact of rods (2, m), and the second nearest in another direction if there may be one.

        A contact is (5, m): place x, y, inward normal x, y, and the gap, negative if the rod overlaps.
        """
        x, y = rods[0] - self._x, rods[1] - self._y
        share = np.minimum(np.maximum((x * self._dx + y * self._dy) / self._square, 0.0), 1.0)
        away_x, away_y = x - share * self._dx, y - share * self._dy
        square = away_x * away_x + away_y * away_y
        pushes = np.arange(rods.shape[1])
        first = self._contact(square.argmin(axis=0), pushes, rods, away_x, away_y, square, radius_m)
        if self._convex:
            return first, None
        distance = np.sqrt(square)
        aligned = -(away_x * first[2] + away_y * first[3]) > _CORNER * distance
        others = np.where(aligned, np.inf, square)
        second = others.argmin(axis=0)
        touch = self._contact(second, pushes, rods, away_x, away_y, square, radius_m)
        touch[4] = np.where(np.isfinite(others[second, pushes]), touch[4], np.inf)
        return first, touch

    @staticmethod
    def _contact(
        edge: Rows, pushes: Rows, rods: Array, away_x: Array, away_y: Array, square: Array, radius_m: Array
    ) -> Array:
        x, y, distance = away_x[edge, pushes], away_y[edge, pushes], np.sqrt(square[edge, pushes])
        safe = np.maximum(distance, _LEAST_M)
        return np.stack([rods[0] - x, rods[1] - y, -x / safe, -y / safe, distance - radius_m])


def _approach(outline: Outline, pushers: Array, radius_m: Array) -> tuple[Array, Array, Array]:
    """Return places (2, n) and headings (2, n) of rods at their first contact, and the travel (n,) that is left.

    A rod that overlaps the outline at the start is moved out of it.
    """
    heading = directions(pushers[:, 2])
    travel_m = first_contact(outline, pushers, radius_m, heading).travel_m
    left = np.maximum(pushers[:, 3] - travel_m, 0.0)  # none of a miss
    place = pushers[:, :2] + heading * (pushers[:, 3] - left)[:, None]
    nearest = outline.nearest(place)
    out = np.maximum(radius_m - nearest.distance_m, 0.0)
    return (place - out[:, None] * nearest.normal).T, heading.T, left


def _placed(pushers: Array, misplaced: Array) -> Array:
    """Return pushers (n, 4) in the true frames (n, 3) of the objects."""
    x, y, yaw = misplaced.T
    place = _rotated(np.stack([pushers[:, 0] - x, pushers[:, 1] - y]), cos(yaw), -sin(yaw))
    return np.column_stack([*place, pushers[:, 2] - yaw, pushers[:, 3]])


def _recorded(outcomes: Array, misplaced: Array) -> Array:
    """Return poses after pushes (n, 3), given in the true frames (n, 3), as motions of the frame that was seen.

    The tracker errs by the same before and after a push, so the seen pose moves with the object.
    """
    x, y, yaw = misplaced.T  # seen frame -> true frame -> moved -> back by the same offset, turned with the object
    moved_x, moved_y = _rotated(outcomes[:, :2].T, cos(yaw), sin(yaw))
    back_x, back_y = _rotated(np.stack([x, y]), cos(outcomes[:, 2]), sin(outcomes[:, 2]))
    return np.column_stack([x + moved_x - back_x, y + moved_y - back_y, outcomes[:, 2]])


def _closing(touch: Array, step: Array) -> Array:
    """Return how far (m,) rods would enter the outline in a step."""
    return np.asarray(touch[2] * step[0] + touch[3] * step[1] - touch[4])


def _sum(values: Array) -> Array:
    """Return the sums (m,) of values (k, m), always added in one order: numpy sums a single column in another."""
    return np.asarray(values.sum(axis=0) if values.shape[1] > 1 else np.cumsum(values, axis=0)[-1])


def _motion_at(touch: Array, motion: Array) -> Array:
    """Return the motion (2, m) of the object at contacts (5, m)."""
    return np.stack([motion[0] - motion[2] * touch[1], motion[1] + motion[2] * touch[0]])


def _rotated(vectors: Array, cos: Array, sin: Array) -> Array:
    return np.stack([cos * vectors[0] - sin * vectors[1], sin * vectors[0] + cos * vectors[1]])
