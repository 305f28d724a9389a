"""Quasi-static mechanics as part of a network: first contact and motion of any outline, in tensors without loops.

The equations are those of ``service.pushing.first_contact`` and ``service.pushing.mechanics``, in float32 and in sizes
of the object. Everything happens in the **push frame**: origin at the centroid, x along the push, y to its left.

- **First contact** is exact: the tip's centre meets an edge that is moved outward by the tip's radius, or a circle
  about a corner.
- **Steps** are seen from the object, which rests while the tip moves and turns about it, so that the outline is
  prepared once. A step has one evaluation: the contact is found where the tip would be half a step later if the object
  kept the last step's motion (a midpoint rule that reuses the step before). A gap between tip and outline is taken off
  the motion along the normal.
- **Sticking and sliding** are one formula. With the levers a and b of normal and tangent over the moment arm, sticking
  needs the force (1, s) for s = ((1 + a^2) y - a b x) / ((1 + b^2) x - a b y), where x and y are the advance along
  normal and tangent. s is clipped to the friction, and the force along the normal is x / (1 + a^2 + a b s).

Steps are unrolled, and only operators are used that ``service.model.onnx_graph`` accepts. Several assumptions on
friction and moment arm are answered at once.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from service.pushing.shape_context import CORNERS

STEPS: Final = 8
FAR: Final = 1e4  # sizes: where edges lie that fill an outline up
LARGEST: Final = 1e6
TOUCH: Final = 1e-5  # sizes: rounding must not turn a touch into a miss
_TINY: Final = 1e-6


class Mechanics(NamedTuple):
    """Pushes as mechanics sees them, in the push frame and in sizes of the object. Zero where a push misses."""

    touches: Tensor
    """(n,) 1 where the tip meets the object, else 0."""
    left: Tensor
    """(n,) length of the push after the first contact."""
    point: Tensor
    """(n, 2) first contact on the outline."""
    normal: Tensor
    """(n, 2) unit vector there, into the object."""
    motion: Tensor
    """(n, 3) motion of the centroid, and yaw in rad: (n, k, 3) for k assumptions."""


class Outlines(NamedTuple):
    """Edges of n outlines in the push frame."""

    start: Tensor  # (n, 64, 2)
    unit: Tensor  # (n, 64, 2) along each edge, 0 for one that fills up
    length: Tensor  # (n, 64)


class PushMechanics(nn.Module):
    """Mechanics of pushes. It has no weights."""

    def __init__(self, assumptions: Sequence[tuple[float, float]] = (), steps: int = STEPS) -> None:
        """Create the module.

        Args:
            assumptions: (factor on the moment arm, factor on the friction) of each answer. Empty: those of the body,
                and the motion has no axis of assumptions.
            steps: steps of the motion in contact.
        """
        super().__init__()
        self.steps = steps
        self.single = not assumptions
        arms, frictions = zip(*(assumptions or ((1.0, 1.0),)), strict=True)
        self.arms = nn.Buffer(torch.tensor(arms, dtype=torch.float32)[:, None], persistent=False)
        self.frictions = nn.Buffer(torch.tensor(frictions, dtype=torch.float32)[:, None], persistent=False)
        self.zeros = nn.Buffer(torch.zeros(6, dtype=torch.int64), persistent=False)

    def forward(self, pusher: Tensor, outline: Tensor, body: Tensor) -> Mechanics:
        """Return the mechanics of pushes (n, 4) of outlines (n, 64, 2) in m with bodies (n, 11), of a caller's frame.

        See ``service.pushing.shape_context`` for the tensors.
        """
        size, centroid = body[:, 2:3], body[:, 0:2]
        angle = pusher[:, 2:3]
        cos, sin = torch.cos(angle), torch.sin(angle)
        turning = torch.stack([torch.cat([cos, -sin], dim=1), torch.cat([sin, cos], dim=1)], dim=1)  # into the frame

        def framed(places: Tensor) -> Tensor:
            """Return places (n, m, 2) in the push frame."""
            return ((places - centroid[:, None]) / size[:, None]) @ turning

        known = framed(torch.cat([outline, pusher[:, None, 0:2], body[:, None, 3:5]], dim=1))
        corners, start, centre = known[:, :CORNERS], known[:, CORNERS], known[:, CORNERS + 1]
        arm, radius = body[:, 6:7] / size, body[:, 9:10] / size
        reach = pusher[:, 3:4] / size
        edges = _edges(corners)
        tables = _tables(edges)
        _, _, clearance = _nearest(tables, start[:, None], self.zeros)
        travel = _first_contact(edges, start, radius)
        travel = torch.where(
            clearance[:, 0] <= radius + TOUCH, torch.zeros_like(travel), travel
        )  # in touch at the start
        touches = travel <= reach
        left = torch.where(touches, reach - travel, torch.zeros_like(reach))
        travel = torch.where(touches, travel, torch.zeros_like(reach))
        tip = start + torch.cat([travel, torch.zeros_like(travel)], dim=1)
        point, normal, distance = _nearest(tables, tip[:, None], self.zeros)
        radius = torch.minimum(radius, distance[:, 0])  # a tip that overlaps at the start is taken to touch
        motion = self._pushed(tables, tip, left, radius, centre, arm, body[:, 7:8])
        hit = touches.to(torch.float32)
        motion = motion * hit[:, None]
        return Mechanics(
            hit[:, 0], left[:, 0], point[:, 0] * hit, normal[:, 0] * hit, motion[:, 0] if self.single else motion
        )

    def _pushed(
        self, tables: Tensor, tip: Tensor, left: Tensor, radius: Tensor, centre: Tensor, arm: Tensor, friction: Tensor
    ) -> Tensor:
        """Return the motions (n, k, 3) of objects that tips (n, 2) push by what is left (n, 1)."""
        arm, friction = arm[:, None] * self.arms, friction[:, None] * self.frictions  # (n, k, 1)
        radius, centre = radius[:, None], centre[:, None]
        none = torch.zeros_like(arm)
        place = tip[:, None] - centre + none  # (n, k, 2) of the tip from the centre of mass, seen from the object
        heading = torch.cat([left[:, None] / self.steps + none, none], dim=2)
        yaw = none

        def force(place: Tensor, heading: Tensor, gap: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
            """Return motions of objects (n, k, 2) and turns (n, k, 1) for tips that advance, and the gaps there."""
            point, normal, distance = _nearest(tables, place + centre, self.zeros)
            found = distance - radius
            lever = point - centre
            x, y = torch.split(normal, 1, dim=2)
            tangent = torch.cat([-y, x], dim=2)
            a = _dot(lever, tangent) / -arm
            b = _dot(lever, normal) / arm
            into = torch.relu(_dot(heading, normal) - (found if gap is None else gap))
            aside = _dot(heading, tangent)
            sticking = (1.0 + a * a) * aside - a * b * into
            slope = sticking / torch.clamp((1.0 + b * b) * into - a * b * aside, min=_TINY)
            slope = torch.minimum(torch.maximum(slope, -friction), friction)
            along = into / (1.0 + a * a + a * b * slope)
            return along * normal + along * slope * tangent, along * (a + b * slope) / arm, found

        for _ in range(self.steps):
            pushed, turn, gap = force(place, 0.5 * heading, None)
            cos, sin = torch.cos(turn), torch.sin(turn)
            middle = _turned_back(place + 0.5 * heading - pushed, cos, sin)
            pushed, turn, _ = force(middle, _turned_back(heading, cos, sin), gap)
            pushed = _turned_back(pushed, cos, -sin)
            cos, sin = torch.cos(turn), torch.sin(turn)
            place = _turned_back(place + heading - pushed, cos, sin)
            heading = _turned_back(heading, cos, sin)
            yaw = yaw + turn
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        end = tip + torch.cat([left, torch.zeros_like(left)], dim=1)
        return torch.cat([end[:, None] - _turned_back(place + centre, cos, -sin), yaw], dim=2)


def _turned_back(vectors: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Return vectors (n, k, 2) turned clockwise."""
    x, y = torch.split(vectors, 1, dim=2)
    return torch.cat([x * cos + y * sin, y * cos - x * sin], dim=2)


def _dot(first: Tensor, second: Tensor) -> Tensor:
    return (first * second).sum(dim=2, keepdim=True)


def _edges(corners: Tensor) -> Outlines:
    """Return the edges of outlines, corners (n, 64, 2)."""
    along = torch.cat([corners[:, 1:], corners[:, :1]], dim=1) - corners
    length = torch.sqrt((along * along).sum(dim=2))
    return Outlines(corners, along / torch.clamp(length, min=_TINY)[..., None], length)


def _first_contact(edges: Outlines, start: Tensor, radius: Tensor) -> Tensor:
    """Return the travel (n, 1) along x from starts (n, 2) to the first contact, ``LARGEST`` for a miss."""
    x, y = torch.split(start[:, None] - edges.start, 1, dim=2)
    x, y = x[..., 0], y[..., 0]  # (n, 64)
    unit_x, unit_y = edges.unit[..., 0], edges.unit[..., 1]
    height = x * unit_y - y * unit_x  # outside of each edge
    far = torch.full_like(height, LARGEST)
    faces = unit_y < -_TINY  # edges that the tip nears: their outward normal is (unit_y, -unit_x)
    to_edge = (height - radius) / torch.where(faces, -unit_y, torch.ones_like(unit_y))
    met = x * unit_x + y * unit_y + to_edge * unit_x
    to_edge = torch.where(faces & (to_edge >= 0.0) & (met >= 0.0) & (met <= edges.length), to_edge, far)
    room = radius * radius - y * y
    to_corner = -x - torch.sqrt(torch.relu(room))
    to_corner = torch.where((room >= 0.0) & (to_corner >= 0.0), to_corner, far)
    return torch.minimum(to_edge, to_corner).amin(dim=1, keepdim=True)


def _tables(edges: Outlines) -> Tensor:
    """Return what a step looks up for each edge (n, 64, 6): middle, unit vector, half length, and zero."""
    half = 0.5 * edges.length
    middle = edges.start + half[..., None] * edges.unit
    filling = edges.length < _TINY
    half = torch.where(filling, torch.full_like(half, -FAR), half)
    return torch.cat([middle, edges.unit, half[..., None], torch.zeros_like(half)[..., None]], dim=2)


def _nearest(tables: Tensor, places: Tensor, zeros: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the nearest points of outlines to places (n, k, 2), inward normals (n, k, 2), and distances (n, k, 1)."""
    offset = places[:, :, None] - tables[:, None, :, 0:2]  # (n, k, 64, 2)
    x, y = offset[..., 0], offset[..., 1]
    unit_x, unit_y, half = (tables[:, None, :, column] for column in (2, 3, 4))
    excess = torch.relu(torch.abs(x * unit_x + y * unit_y) - half)
    height = x * unit_y - y * unit_x
    nearest = (excess * excess + height * height).argmin(dim=2, keepdim=True) + zeros  # (n, k, 6)
    found = torch.gather(tables, 1, nearest)
    middle, unit, half, _ = torch.split(found, [2, 2, 1, 1], dim=2)
    along = ((places - middle) * unit).sum(dim=2, keepdim=True)
    point = middle + unit * torch.minimum(torch.maximum(along, -half), half)
    gap = point - places
    unit_x, unit_y = torch.split(unit, 1, dim=2)
    inward = torch.cat([-unit_y, unit_x], dim=2)
    length = torch.sqrt((gap * gap).sum(dim=2, keepdim=True))
    outside = (gap * inward).sum(dim=2, keepdim=True) >= 0.0
    beyond = torch.abs(along) > half
    distance = torch.where(outside | beyond, length, -length)
    clear = length > _TINY
    normal = torch.where(clear, gap / torch.where(clear, distance, torch.ones_like(distance)), inward)
    return point, normal, distance
