"""Quasi-static mechanics as part of a network: first contact and motion of any outline, in tensors without loops.

An object rests on points that bear shares of its weight (``service.pushing.support``), and each resists with Coulomb
friction. The pusher moves in a straight line. In each small step the object moves so that friction balances the force
of the contact, which lies within the friction cone and keeps the tip out of the outline. These are the equations of the
simulation, without its scatter, in float32. Results are in sizes of the object and in the **push frame**: origin at the
centroid, x along the push, y to its left.

- **First contact** is exact: the tip's centre meets an edge that is moved outward by the tip's radius, or a circle
  about a corner.
- **Steps** (midpoint rule) are seen from the object, which rests while the tip moves and turns about it. So the points
  and the edges are prepared once. A gap between tip and outline is taken off the motion along the normal.
- **Friction** is linearised about the motion of the evaluation before: a point that moves at a speed v resists like a
  damper of share over v (iteratively reweighted least squares). About the centre of these dampers, forces and motions
  are those of an ellipsoidal limit surface, whose moment arm is the dampers' radius of gyration.
- **Sticking and sliding** are one formula. With the levers a and b of normal and tangent over the moment arm, sticking
  needs the force (1, s) for s = ((1 + a^2) y - a b x) / ((1 + b^2) x - a b y), where x and y are the advance along
  normal and tangent. s is clipped to the friction, and the force along the normal is x / (1 + a^2 + a b s).

Steps are unrolled, and only operators are used that ``service.model.onnx_graph`` accepts.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from service.pushing.shape_context import CORNERS
from training.networks.contact import TINY, Edges, OutlineEdges, first_contact

STEPS: Final = 5
REST: Final = 0.02  # of the mean speed: a point that moves less is held by less than its whole friction
_LEAST: Final = 1e-9
_JAMMED: Final = 0.05  # below it the force that slides would rather jam the tip


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
    """(n, 3) motion of the centroid, and yaw in rad."""


class _Nearest(NamedTuple):
    """Nearest places of outlines to places (n, 2)."""

    point: Tensor  # (n, 2)
    normal: Tensor  # (n, 2) unit vector into the object
    distance: Tensor  # (n, 1) negative inside


class _Push(NamedTuple):
    """Parts of pushes that stay the same from step to step. Lengths are in sizes, from the centroid."""

    edges: Edges
    points: Tensor  # (n, 37, 2) of support
    shares: Tensor  # (n, 37)
    moments: Tensor  # (n, 37, 4): 1, x, y, x^2 + y^2 of each point
    radius: Tensor  # (n, 1)
    friction: Tensor  # (n, 1)


class PushMechanics(nn.Module):
    """Mechanics of pushes. It has no weights."""

    def __init__(self, steps: int = STEPS) -> None:
        """Create the module. Each of the ``steps`` of the motion in contact has two evaluations."""
        super().__init__()
        self.steps = steps
        self.row_of_numbers = nn.Buffer(torch.zeros(4, 1, dtype=torch.int64), persistent=False)
        self.row_of_ways = nn.Buffer(torch.zeros(8, dtype=torch.int64), persistent=False)
        self.quarter = nn.Buffer(torch.tensor([[0.0, 1.0], [-1.0, 0.0]]), persistent=False)  # turns to the left
        self.edges = OutlineEdges()

    def forward(
        self, pusher: Tensor, outline: Tensor, support: Tensor, body: Tensor, context_index: Tensor | None = None
    ) -> Mechanics:
        """Return the mechanics of pushes (n, 4) of objects with these tensors, see ``service.pushing.shape_context``.

        Args:
            pusher: (n, 4) x_m, y_m, angle_rad, length_m.
            outline: (g, 64, 2).
            support: (g, 37, 3).
            body: (g, 11).
            context_index: (n,) the object of each push. None: each has its own.
        """
        size, centroid = body[:, 2:3], body[:, 0:2]
        edges = self.edges(outline, centroid[:, None], size[:, None])
        points = (support[..., :2] - centroid[:, None]) / size[:, None]
        moments = torch.cat([torch.ones_like(points[..., :1]), points, (points * points).sum(2, keepdim=True)], dim=2)
        parts: tuple[Tensor, ...] = (points, support[..., 2], moments, body)
        if context_index is not None:
            edges = Edges(*(torch.index_select(part, 0, context_index) for part in edges))
            parts = tuple(torch.index_select(part, 0, context_index) for part in parts)
        points, shares, moments, body = parts
        size, centroid = body[:, 2:3], body[:, 0:2]
        ahead = torch.cat([torch.cos(pusher[:, 2:3]), torch.sin(pusher[:, 2:3])], dim=1)
        start, length, radius = (pusher[:, 0:2] - centroid) / size, pusher[:, 3:4] / size, body[:, 9:10] / size
        travel = first_contact(edges, start[:, None], ahead[:, None], radius[..., None])[:, 0]
        hit = (travel <= length).to(torch.float32)
        left, travel = (length - travel) * hit, travel * hit
        tip = start + travel * ahead
        first = self._nearest(edges, tip)
        push = _Push(edges, points, shares, moments, torch.minimum(radius, first.distance), body[:, 7:8])
        place, yaw = self._pushed(push, tip, left * ahead)
        frame = torch.stack([ahead, ahead @ self.quarter], dim=2)  # (n, 2, 2) into the push frame
        moved = tip + left * ahead - _turned(place, torch.cos(yaw), torch.sin(yaw))
        vectors = torch.stack([moved, first.point, first.normal], dim=1) @ frame * hit[:, None]
        return Mechanics(
            hit[:, 0], left[:, 0], vectors[:, 1], vectors[:, 2], torch.cat([vectors[:, 0], yaw * hit], dim=1)
        )

    def _pushed(self, push: _Push, tip: Tensor, advance: Tensor) -> tuple[Tensor, Tensor]:
        """Push objects with tips (n, 2) in contact that advance (n, 2).

        Return where the tips end, seen from the objects, and the yaw (n, 1).
        """
        heading, place = advance / self.steps, tip
        motion = torch.cat([heading, torch.zeros_like(heading[:, :1])], dim=1)  # of the object, for its dampers
        yaw = torch.zeros_like(heading[:, :1])
        for step in range(self.steps):
            contact = self._nearest(push.edges, place)
            gap = contact.distance - push.radius
            if step == 0:
                motion, _ = self._moved(push, contact, 0.5 * heading, gap, motion)
            motion, moved = self._moved(push, contact, 0.5 * heading, gap, motion)
            turn = moved[:, 2:]
            cos, sin = torch.cos(turn), torch.sin(turn)
            middle = _turned(place + 0.5 * heading - moved[:, :2], cos, -sin)
            motion, moved = self._moved(
                push, self._nearest(push.edges, middle), _turned(heading, cos, -sin), gap, motion
            )
            shift, turn = _turned(moved[:, :2], cos, sin), moved[:, 2:]
            cos, sin = torch.cos(turn), torch.sin(turn)
            place, heading = _turned(place + heading - shift, cos, -sin), _turned(heading, cos, -sin)
            yaw = yaw + turn
        return place, yaw

    def _moved(
        self, push: _Push, contact: _Nearest, advance: Tensor, gap: Tensor, motion: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return motions (n, 3) of objects about their centroids, for dampers and for the step.

        The first keeps the motion before where a tip does not push, so that dampers always have one.
        """
        speed = motion[:, None, :2] + motion[:, None, 2:] * (push.points @ self.quarter)
        speed = torch.sqrt((speed * speed).sum(dim=2))
        least = torch.clamp(REST * speed.mean(dim=1, keepdim=True), min=_LEAST)
        damping = push.shares / torch.maximum(speed, least)
        sums = (damping[:, None] @ push.moments)[:, 0]
        means = sums[:, 1:] / sums[:, :1]
        centre = means[:, :2]
        arm = torch.sqrt(torch.clamp(means[:, 2:] - (centre * centre).sum(dim=1, keepdim=True), min=TINY))
        normal = contact.normal
        tangent = normal @ self.quarter
        lever = (contact.point - centre) / arm
        a, b = -(lever * tangent).sum(dim=1, keepdim=True), (lever * normal).sum(dim=1, keepdim=True)
        into = torch.relu((advance * normal).sum(dim=1, keepdim=True) - gap)
        aside = (advance * tangent).sum(dim=1, keepdim=True)
        sticking = (1.0 + a * a) * aside - a * b * into
        slope = sticking / torch.clamp((1.0 + b * b) * into - a * b * aside, min=_LEAST)
        slope = torch.minimum(torch.maximum(slope, -push.friction), push.friction)
        along = into / torch.clamp(1.0 + a * a + a * b * slope, min=_JAMMED)
        turn = along * (a + b * slope) / arm
        moved = torch.cat([along * (normal + slope * tangent) - turn * (centre @ self.quarter), turn], dim=1)
        return torch.where(along > 0.0, moved, motion), moved

    def _nearest(self, edges: Edges, place: Tensor) -> _Nearest:
        """Return the nearest places of outlines to places (n, 2)."""
        numbers = torch.clamp(place[:, None] @ edges.numbers[:, :2] + edges.numbers[:, 2:], min=1e-12)
        numbers = numbers.reshape(-1, 4, CORNERS)
        squares = (numbers * numbers).sum(dim=1, keepdim=True)
        edge = squares.argmin(dim=2, keepdim=True)  # (n, 1, 1)
        numbers = torch.gather(numbers, 2, edge + self.row_of_numbers)  # (n, 4, 1)
        ways = torch.gather(edges.ways, 1, edge + self.row_of_ways).reshape(-1, 4, 2)
        length = torch.sqrt(squares.amin(dim=2))
        distance = length - 2.0 * numbers[:, 3]
        normal = (numbers * ways).sum(dim=1) / length
        return _Nearest(place + distance * normal, normal, distance)


def _turned(vectors: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Return vectors (n, 2) turned to the left by angles with these cosines and sines (n, 1)."""
    x, y = vectors[:, :1], vectors[:, 1:]
    return torch.cat([x * cos - y * sin, x * sin + y * cos], dim=1)
