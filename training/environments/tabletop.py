"""Table with one object of any outline, in MuJoCo, which straight pushes move one after the other.

The way in which the object's weight is spread is drawn once. The friction of the table under each foot, and that of the
pusher about its mean, are drawn for every push. Poses are true ones, without the noise of a tracker. A start that
overlaps the wall of the object is moved out of it. The free travel before the first contact is not simulated, so a push
costs as much as its contact: about 7 ms, and 35 ms if a push of 120 mm moves a body on 30 feet all the way.

Lengths are metres, angles radians, in the frame of the world. The object frame is that of the outline.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from mujoco import rollout

from service.errors import InvalidRequestError
from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import MAX_LENGTH_M, WORLD_M, DoubleArray, into_object_frame, wrap_angle
from service.pushing.support import balanced
from training.simulation.bodies import ANY_PLATE, Body, Conditions, Physics, draw_body, draw_conditions
from training.simulation.pieces import convex_pieces
from training.simulation.scene import PUSHER_RADIUS_M, push_object
from training.simulation.solids import BODY_DENSITY_KG_M3, HEIGHT_M, Solid, Weight

TABLE_FRICTION: Final = (0.13, 0.28)  # levels of worn ABS and of new plywood, between which a push is drawn
_LOW_M: Final = 0.003  # height of the contact over the table, so that no object tips
_GAP_M: Final = 0.0002  # between pusher and wall where the simulation begins
_LEAST_M: Final = 1e-6  # a shorter push leaves the object


class Tabletop:
    """Table with one object, in MuJoCo. The same seed and pushes give the same poses."""

    def __init__(
        self,
        outline: Outline,
        pose: npt.ArrayLike = (0.0, 0.0, 0.0),
        seed: int = 0,
        *,
        centre_of_mass_m: npt.ArrayLike | None = None,
        friction: float | None = None,
        pusher_radius_m: float = PUSHER_RADIUS_M,
        physics: Physics = ANY_PLATE,
    ) -> None:
        """Put the object on the table.

        Args:
            outline: the object.
            pose: (3,) x_m, y_m, yaw_rad of the object in the world.
            seed: of all that is drawn.
            centre_of_mass_m: (2,) in the frame of the outline, by default the centroid.
            friction: mean coefficient of friction of pusher and object, by default that of ``physics``.
            pusher_radius_m: radius of the pusher's tip.
            physics: distribution of what is drawn. Its noise of a tracker is not used.

        Raises:
            InvalidRequestError: the pose is no pose.
            ValueError: no support under the object balances at the centre of mass.
        """
        self.outline = outline
        self.pusher_radius_m = pusher_radius_m
        self._rng = np.random.default_rng(seed)
        self._physics = physics.of(friction)
        centre = outline.centroid_m if centre_of_mass_m is None else np.asarray(centre_of_mass_m, dtype=np.float64)
        self._body = draw_body(outline, physics, self._rng, centre)
        self._solid = _solid(self._body)
        self.pose = pose

    @property
    def pose(self) -> DoubleArray:
        """Return the pose (3,) of the object in the world: x_m, y_m, yaw_rad in (-pi, pi]."""
        return self._pose.copy()

    @pose.setter
    def pose(self, pose: npt.ArrayLike) -> None:
        x, y, yaw = _finite(pose, "pose", 3)
        self._pose = np.array([x, y, wrap_angle(yaw)])

    def push(self, push: npt.ArrayLike) -> DoubleArray:
        """Push the object, and return its pose (3,) in the world after the push.

        Args:
            push: (4,) x_m, y_m of the tip's centre at its start, angle_rad of its straight way, length_m of it.

        Raises:
            InvalidRequestError: a value is not finite, the length is not 0 to 1 m, or the start is inside the object.
        """
        pusher = self._in_object_frame(_finite(push, "push", 4))
        drawn = draw_conditions(self._body, self._physics, 1, self._rng)
        level = self._rng.uniform(*TABLE_FRICTION)
        touching = self._from_touch(pusher)
        if touching[3] > _LEAST_M:
            conditions = _Table(self._pose[None], drawn.contact, level * _roughness(self._body, drawn))
            with rollout.Rollout(nthread=0) as pool:
                (moved,) = push_object(
                    self._solid,
                    touching[None, :3],
                    conditions,
                    pool,
                    threads=1,
                    push_length_m=float(touching[3]),
                    pusher_radius_m=self.pusher_radius_m,
                    pusher_height_m=_LOW_M,
                )
            self._pose = _composed(self._pose, moved)
        return self.pose

    def depth_m(self, push: DoubleArray) -> float:
        """Return how deep the start of a push (4,) in the world is inside of the object. It is negative outside."""
        start = into_object_frame(push[None, :3], self._pose[None])[:, :2]
        return -float(self.outline.distance_m(start)[0])

    def _in_object_frame(self, push: DoubleArray) -> DoubleArray:
        """Return a push (4,) of the world in the object frame, if it is one."""
        if not 0.0 <= push[3] <= MAX_LENGTH_M:
            raise InvalidRequestError.at("push.3", f"a length of {push[3]:g} m", f"0 to {MAX_LENGTH_M:g} m")
        depth_m = self.depth_m(push)
        if depth_m > 0.0:
            received = f"a start at ({push[0]:.4g}, {push[1]:.4g}) m, {1e3 * depth_m:.3g} mm inside the object"
            raise InvalidRequestError.at("push", received, "a start outside of the object's outline")
        return np.append(into_object_frame(push[None, :3], self._pose[None])[0], push[3])

    def _from_touch(self, pusher: DoubleArray) -> DoubleArray:
        """Return the rest of a push (4,), in the object frame, from just before its first contact on.

        Its length is 0 if the push misses.
        """
        contact = first_contact(self.outline, pusher[None], self.pusher_radius_m)
        free_m = max(float(contact.travel_m[0]) - _GAP_M, 0.0)
        if not np.isfinite(free_m):
            return np.array([*pusher[:3], 0.0])
        start = pusher[:2] + free_m * np.array([np.cos(pusher[2]), np.sin(pusher[2])])
        nearest = self.outline.nearest(start[None])
        out_m = max(self.pusher_radius_m - float(nearest.distance_m[0]), 0.0)
        return np.array([*(start - out_m * nearest.normal[0]), pusher[2], pusher[3] - free_m])


@dataclass(frozen=True, eq=False)
class _Table:
    """Conditions of pushes on a table whose friction under each foot is given."""

    world_poses: DoubleArray  # (n, 3)
    contact: DoubleArray  # (n,)
    friction: DoubleArray  # (n, feet)

    def table_friction(self, feet_m: DoubleArray) -> DoubleArray:
        """Return the friction (n, feet, 2) of feet (n, feet, 2) along both axes, alike wherever they are."""
        return np.broadcast_to(self.friction[..., None], feet_m.shape)


def _solid(body: Body) -> Solid:
    """Return the solid of a body: an extra weight as heavy as itself moves its centre of mass to where it is."""
    offset = body.centre_of_mass_m - body.outline.centroid_m
    x_m, y_m = body.outline.centroid_m + 2.0 * offset
    mass_kg = body.outline.area_m2 * HEIGHT_M * BODY_DENSITY_KG_M3
    weights = (Weight(float(x_m), float(y_m), mass_kg),) if offset.any() else ()
    feet = tuple((float(x), float(y)) for x, y in body.feet_m)
    return Solid(convex_pieces(body.outline), weights, feet)


def _roughness(body: Body, drawn: Conditions) -> DoubleArray:
    """Return the friction (n, feet) of feet over the table's level.

    The scene shares the weight evenly, as far as it balances. Where the body does not, friction does in its place.
    """
    feet = len(body.feet_m)
    even = balanced(body.feet_m, np.full(feet, 1.0 / feet), body.centre_of_mass_m, body.outline.size_m)
    return np.asarray((drawn.loads / (body.loads if even is None else even)[:, None]).T)


def _composed(pose: DoubleArray, moved: DoubleArray) -> DoubleArray:
    """Return the pose (3,) in the world of a pose (3,) given in the frame of another."""
    (x, y, yaw), (dx, dy, turn) = pose, moved
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([x + cos * dx - sin * dy, y + sin * dx + cos * dy, wrap_angle(float(yaw + turn))])


def _finite(values: npt.ArrayLike, where: str, count: int) -> DoubleArray:
    found = np.asarray(values, dtype=np.float64)
    if found.shape != (count,) or not (np.abs(found) <= WORLD_M).all():  # NaN compares as false
        accepted = f"{count} finite numbers within {WORLD_M:g}, in metres and radians"
        raise InvalidRequestError.at(where, f"{values!r:.100}", accepted)
    return found
