"""Quasi-static mechanics: where a rigid object on a table ends up when a round tip pushes it along a straight line.

Nothing is fitted. Pressure is spread evenly over the outline, and the motion is so slow that only friction counts. The
equations are about the centre of mass, in the object's frame:

- **Limit surface**: force f and moment m of the push lie on |f|^2 / f_max^2 + m^2 / m_max^2 = 1, and the motion is
  normal to that ellipsoid (Goyal, Ruina, Papadopoulos 1991; Howe, Cutkosky 1996): v = k f, w = k m / c^2. Only
  c = m_max / f_max matters. With even pressure it is the mean distance of the area from the centre of mass.
- **Contact** at r, where m = r' . f with r' = (-r_y, r_x): the material there moves by k A f, A = I + r' r'^T / c^2.
- **Sticking** (Lynch, Maekawa, Tanie 1992): the contact moves as the tip does, by u, so k f = A^-1 u. It holds if that
  force lies in the friction cone, |f . t| <= mu f . n, with n the inward normal and t the tangent.
- **Sliding**: else the force lies on the edge e = n +- mu t of the cone on that side, and the tip slips along the
  outline: k f = e (u . n) / (n . A e). Only the motion along the normal is the tip's.

The first contact is exact. From there the tip advances in even steps (midpoint rule). In each the contact is the
nearest place of the outline, and a gap between tip and outline is taken off the motion along the normal, so that errors
do not add up. A tip that leaves the object, and meets it again, is covered by the same rule. In a notch a tip touches
two sides, so that a step along one enters the other. The object is then pushed off the tip, by turns, before the next.

Figure of merit: mean error on recorded pushes beside other models, in docs/results/real-pushes. Twice the size and
twice the push are twice the answer, because no length but those of object and push enters. numpy only.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angles

FRICTION: Final = 0.25  # of tip and object: "approximately 0.25" (Yu, Bauza, Fazeli, Rodriguez, IROS 2016)
STEPS: Final = 25  # on average 0.01 mm from 200 steps on recorded pushes of 50 mm, and 12 steps 0.03 mm
ENTERED: Final = 1e-4  # of the object's size: tips that are deeper in an object are pushed off
MOST_TURNS: Final = 3  # between the sides of a notch


def push(
    outline: Outline,
    pushers: DoubleArray,
    pusher_radius_m: npt.ArrayLike,
    friction: npt.ArrayLike = FRICTION,
    centre_of_mass_m: npt.ArrayLike | None = None,
    steps: int = STEPS,
    arm: float = 1.0,
) -> DoubleArray:
    """Return the object's poses (n, 3) after pushes, x_m, y_m, yaw_rad, in its frame before the push.

    A push that misses leaves the object exactly where it is. A tip that overlaps the object at the start is taken to
    touch it.

    Args:
        outline: the object, in a frame of any origin and orientation.
        pushers: (n, 4) x_m, y_m, angle_rad, length_m: the tip's centre, direction and travel.
        pusher_radius_m: radius of the tip, one for all or (n,).
        friction: coefficient of friction of tip and object, one for all or (n,).
        centre_of_mass_m: (2,), the centroid of the outline if left out.
        steps: steps of the motion in contact.
        arm: moment arm of the pressure over that of even pressure.
    """
    pushers = np.asarray(pushers, dtype=np.float64)
    outcomes = np.zeros((len(pushers), 3))
    travel = first_contact(outline, pushers, pusher_radius_m).travel_m
    touches = np.isfinite(travel)
    radius, coefficient = (
        np.broadcast_to(np.asarray(value, dtype=np.float64), len(pushers))[touches]
        for value in (pusher_radius_m, friction)
    )
    centre = outline.centroid_m if centre_of_mass_m is None else np.asarray(centre_of_mass_m, dtype=np.float64)
    pushers, travel = pushers[touches], travel[touches]
    direction = np.stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])], axis=1)
    tip = pushers[:, :2] + travel[:, None] * direction
    arm_m = arm * moment_arm_m(outline, centre)
    touching = _Touching(outline, centre, arm_m, np.minimum(radius, outline.distance_m(tip)), coefficient)
    advance = direction * ((pushers[:, 3] - travel) / steps)[:, None]
    pose = np.concatenate([np.broadcast_to(centre, tip.shape), np.zeros((len(tip), 1))], axis=1)
    for _ in range(steps):
        contact = touching.settle(pose, tip)
        half = pose + touching.motion(contact, pose, advance / 2.0)
        middle = touching.contact(half, tip + advance / 2.0)
        pose = pose + touching.motion(replace(middle, gap_m=contact.gap_m), half, advance)
        tip = tip + advance
    touching.settle(pose, tip)
    outcomes[touches, :2] = pose[:, :2] - _turned(np.broadcast_to(centre, tip.shape), pose[:, 2])
    outcomes[touches, 2] = wrap_angles(pose[:, 2])
    return outcomes


def moment_arm_m(outline: Outline, about: DoubleArray) -> float:
    """Return the largest moment over the largest force of evenly spread pressure: the mean distance from a point (2,).

    The integral over the area is a sum over edges. A triangle from the point to an edge at height h, between places a
    and b along the edge, gives F(b) - F(a) with F(t) = (h t sqrt(h^2 + t^2) + h^3 asinh(t / |h|)) / 6.
    """
    start, edges = outline.corners - about, outline.edges
    length = np.sqrt(_dot(edges, edges))
    height = _cross(start, edges) / length
    first = _dot(start, edges) / length
    apart = np.where(height == 0.0, 1.0, np.abs(height))  # an edge towards the point spans no area

    def integral(place: DoubleArray) -> DoubleArray:
        """Return F at places (n,) along the edges."""
        found: DoubleArray = height * place * np.sqrt(height**2 + place**2) + height**3 * np.arcsinh(place / apart)
        return found / 6.0

    return float((integral(first + length) - integral(first)).sum() / outline.area_m2)


@dataclass(frozen=True, eq=False)
class _Contact:
    """Contacts of n tips: places r (n, 2) from the centre of mass, inward normals (n, 2), and gaps (n,)."""

    place_m: DoubleArray
    normal: DoubleArray
    gap_m: DoubleArray


@dataclass(frozen=True, eq=False)
class _Touching:
    """Pushes of one outline from their first contact on. Poses (n, 3) are those of its centre of mass."""

    outline: Outline
    centre: DoubleArray
    arm_m: float
    radius_m: DoubleArray
    friction: DoubleArray

    def rows(self, rows: npt.NDArray[np.int64]) -> "_Touching":
        """Return some of the pushes."""
        return replace(self, radius_m=self.radius_m[rows], friction=self.friction[rows])

    def contact(self, pose: DoubleArray, tip: DoubleArray) -> _Contact:
        """Return the contacts of tips with centres (n, 2): the nearest places of the outline."""
        found = self.outline.nearest(_turned(tip - pose[:, :2], -pose[:, 2]) + self.centre)
        return _Contact(found.point_m - self.centre, found.normal, found.distance_m - self.radius_m)

    def settle(self, pose: DoubleArray, tip: DoubleArray) -> _Contact:
        """Push objects, in place, off the tips that entered them, and return the contacts."""
        found = self.contact(pose, tip)
        for _ in range(MOST_TURNS):
            deep = np.flatnonzero(found.gap_m < -ENTERED * self.outline.size_m)
            if not len(deep):
                break
            some = self.rows(deep)
            entered = _Contact(found.place_m[deep], found.normal[deep], found.gap_m[deep])
            pose[deep] += some.motion(entered, pose[deep], np.zeros((len(deep), 2)))
            left = some.contact(pose[deep], tip[deep])
            found.place_m[deep], found.normal[deep], found.gap_m[deep] = left.place_m, left.normal, left.gap_m
        return found

    def motion(self, contact: _Contact, pose: DoubleArray, advance: DoubleArray) -> DoubleArray:
        """Return the motions (n, 3) of objects whose tips advance by (n, 2), the gaps closed first."""
        r, n = contact.place_m, contact.normal
        u = _turned(advance, -pose[:, 2]) - contact.gap_m[:, None] * n
        lever, t = _left(r), _left(n)
        square = self.arm_m**2
        pushed = _dot(u, n)
        force = u - lever * (_dot(lever, u) / (square + _dot(r, r)))[:, None]  # A^-1 u
        sideways = _dot(force, t)
        edge = n + (np.sign(sideways) * self.friction)[:, None] * t
        slip = edge * (pushed / (1.0 + _dot(n, lever) * _dot(lever, edge) / square))[:, None]
        sticks = np.abs(sideways) <= self.friction * _dot(force, n)
        force = np.where(sticks[:, None], force, slip)
        force = np.where((pushed > 0.0)[:, None], force, 0.0)  # a tip does not pull
        return np.concatenate([_turned(force, pose[:, 2]), (_dot(lever, force) / square)[:, None]], axis=1)


def _left(vectors: DoubleArray) -> DoubleArray:
    """Return vectors (n, 2) turned by a quarter."""
    return np.stack([-vectors[:, 1], vectors[:, 0]], axis=1)


def _turned(vectors: DoubleArray, angles_rad: DoubleArray) -> DoubleArray:
    """Return vectors (n, 2) turned by angles (n,)."""
    cos, sin = np.cos(angles_rad), np.sin(angles_rad)
    return np.stack([cos * vectors[:, 0] - sin * vectors[:, 1], sin * vectors[:, 0] + cos * vectors[:, 1]], axis=1)


def _dot(first: DoubleArray, second: DoubleArray) -> DoubleArray:
    return first[:, 0] * second[:, 0] + first[:, 1] * second[:, 1]


def _cross(first: DoubleArray, second: DoubleArray) -> DoubleArray:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
