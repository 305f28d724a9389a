"""Quasi-static mechanics as part of a network: first contact and motion of any outline, in tensors without loops.

The equations are those of ``service.pushing.first_contact`` and ``service.pushing.mechanics``, in float32. Results are
in sizes of the object and in the **push frame**: origin at the centroid, x along the push, y to its left.

- **First contact** is exact: the tip's centre meets an edge that is moved outward by the tip's radius, or a circle
  about a corner.
- **Steps** (midpoint rule) are seen from the object, which rests while the tip moves and turns about it. So what they
  look up is prepared once per object. Lengths are in moment arms from the centre of mass on, which leaves no factor.
- **Nearest place**: four numbers tell how far a place is from an edge: beyond its end, before its start, outside of it,
  and inside of it. All are linear in the place, so one product gives them for all edges, and the sum of the squares of
  those that are positive is the squared distance.
- **Sticking and sliding** are one formula in the frame of the contact: x along the inward normal n, y to its left. With
  the lever (b, t) of the contact and the advance (x, y) of the tip, the force that sticks is parallel to
  (x, y) + (b, t) (b x + t y). Its slope s is clipped to the friction. Then the force along the normal is
  x / (1 - t (b s - t)), and the turn is that times (b s - t).

Small tensors cost a runtime as much as large ones: the number of operators counts, so frames are changed for all
vectors of a row together, as products of complex numbers by constant matrices (see ``_Half``). Steps are unrolled, and
only operators are used that ``service.model.onnx_graph`` accepts.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from service.pushing.shape_context import CORNERS
from training.networks.contact import TINY, Edges, OutlineEdges, first_contact

STEPS: Final = 6
_LEAST: Final = 1e-12  # moment arms: a place on the outline has a normal, too


Matrix = list[list[float]]
_X: Final = [1.0, 0.0, 0.0, 0.0]
_Y: Final = [0.0, 1.0, 0.0, 0.0]
_NONE: Final = [0.0, 0.0, 0.0, 0.0]
# From the place p of the tip and half of its advance, h, to the place m in the middle of the step, p and h.
_ADVANCE: Final = [_X, _Y, [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
_HALF_STEP: Final = [
    [1.0, 0.0, 1.0, 0.0, 0.0, 0.0],
    [0.0, 1.0, 0.0, 1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    [0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
]
_FROM_MIDDLE: Final = [[-1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0, 0.0, 0.0]]
# From m, p and h to p + 2 h and h. The forces are those at m.
_WHOLE: Final = [_X, _Y, _NONE, _NONE, [0.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 2.0]]
_STEP: Final = [_NONE, _NONE, _X, _Y, [2.0, 0.0, 1.0, 0.0], [0.0, 2.0, 0.0, 1.0]]
_FROM_START: Final = [[-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0]]


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


class _Lookup:
    """Tables by which the nearest place is found. Lengths are in moment arms."""

    def __init__(self, numbers: Tensor, ways: Tensor, arm: Tensor) -> None:
        """Take the tables of ``Edges``, and moment arms (n, 1, 1) in sizes."""
        self.slopes, self.offsets, self.ways = numbers[:, :2], numbers[:, 2:] / arm, ways


class _Nearest(NamedTuple):
    """Nearest places of outlines."""

    normal: Tensor  # (n, 1, 2) unit vector into the object, from the tip to the outline where it is outside
    distance: Tensor  # (n, 1, 1) negative inside


class PushMechanics(nn.Module):
    """Mechanics of pushes. It has no weights."""

    def __init__(self, assumptions: Sequence[tuple[float, float]] = (), steps: int = STEPS) -> None:
        """Create the module.

        Args:
            assumptions: (factor on the moment arm, factor on the friction) of each answer. Empty: those of the body,
                and the motion has no axis of assumptions.
            steps: steps of the motion in contact, with two evaluations each.
        """
        super().__init__()
        self.steps = steps
        self.single = not assumptions
        self.count = max(1, len(assumptions))
        arms, frictions = zip(*(assumptions or ((1.0, 1.0),)), strict=True)

        self.arms, self.frictions = (
            nn.Buffer(torch.tensor(values, dtype=torch.float32), persistent=False) for values in (arms, frictions)
        )
        self.row_of_numbers = nn.Buffer(torch.zeros(4, 1, dtype=torch.int64), persistent=False)
        self.row_of_ways = nn.Buffer(torch.zeros(8, dtype=torch.int64), persistent=False)
        self.quarter = nn.Buffer(torch.tensor([[0.0, 1.0], [-1.0, 0.0]]), persistent=False)  # turns to the left
        self.edges = OutlineEdges()
        self.place = _Half(2, 3, _ADVANCE, _HALF_STEP, _FROM_MIDDLE)
        self.middle = _Half(3, 2, _WHOLE, _STEP, _FROM_START)

    def forward(self, pusher: Tensor, outline: Tensor, body: Tensor, context_index: Tensor | None = None) -> Mechanics:
        """Return the mechanics of pushes (n, 4) of objects with outlines (g, 64, 2) in m and bodies (g, 11).

        See ``service.pushing.shape_context`` for the tensors. ``context_index`` (n,) names the object of each push.
        None: each has its own.
        """
        body = body[:, None]  # as vectors: all tensors below have three dimensions
        pusher = pusher[:, None]
        edges = self.edges(outline, body[..., 3:5], body[..., 2:3])
        arm = body[..., 6:7] / body[..., 2:3] * self.arms  # (g, 1, k)
        if context_index is not None:
            edges = Edges(*(torch.index_select(part, 0, context_index) for part in edges))
            arm, body = (torch.index_select(part, 0, context_index) for part in (arm, body))
        size, centre_m = body[..., 2:3], body[..., 3:5]
        ahead = torch.cat([torch.cos(pusher[..., 2:3]), torch.sin(pusher[..., 2:3])], dim=2)  # along the push
        start = (pusher[..., 0:2] - centre_m) / size
        length, radius = pusher[..., 3:4] / size, body[..., 9:10] / size
        travel = first_contact(edges, start, ahead, radius)
        hit = (travel <= length).to(torch.float32)
        travel = travel * hit
        left = length * hit - travel
        advance = left * ahead
        tip = start + travel * ahead
        scale = arm.reshape(-1, 1, 1)  # (n k, 1, 1): a row for each assumption on each push
        tables = _Lookup(self._repeated(edges.numbers), self._repeated(edges.ways), scale)
        rows = self._repeated(torch.cat([tip, advance / (2.0 * self.steps)], dim=2))
        limit = (body[..., 7:8] * self.frictions).reshape(-1, 1, 1)
        first, place, yaw = self._pushed(tables, rows / scale, self._repeated(radius) / scale, limit)
        frame = torch.cat([ahead, ahead @ self.quarter], dim=1).transpose(1, 2)  # (n, 2, 2) into the push frame
        centre = (centre_m - body[..., 0:2]) / size  # of mass, from the centroid
        normal, distance, place, yaw = (
            part.reshape(-1, self.count, part.shape[2])
            for part in (first.normal, first.distance * scale, place * scale, yaw)
        )
        normal, tip = normal[:, :1], tip + centre
        point = tip + distance[:, :1] * normal
        place = place + centre
        turned = place * torch.cos(yaw) + (place @ self.quarter) * torch.sin(yaw)
        motion = torch.cat([(tip + advance - turned) @ frame, yaw], dim=2) * hit
        return Mechanics(
            hit[:, 0, 0],
            left[:, 0, 0],
            (point @ frame * hit)[:, 0],
            (normal @ frame * hit)[:, 0],
            motion[:, 0] if self.single else motion,
        )

    def _repeated(self, part: Tensor) -> Tensor:
        """Return each row of a tensor (n, ...) k times, (n k, ...)."""
        return part if self.count == 1 else part.repeat_interleave(self.count, dim=0)

    def _pushed(
        self, tables: "_Lookup", rows: Tensor, radius: Tensor, limit: Tensor
    ) -> tuple[_Nearest, Tensor, Tensor]:
        """Push objects with tips at (n, 1, 2), followed by half of the advance of a step, all in moment arms.

        Return the first contacts, where the tips are in the end (n, 1, 2), seen from the objects, and the yaw.
        """
        state = rows @ self.place.spread  # (n, 1, 8)
        limits = limit, -limit
        first = self._nearest(tables, state)
        radius = torch.minimum(radius, first.distance)  # one that overlaps is in touch
        yaw = torch.zeros_like(radius)
        for step in range(self.steps):
            found = first if step == 0 else self._nearest(tables, state)
            gap = found.distance - radius
            state, turn = self.place(state, found, gap, None, limits)
            state, whole_turn = self.middle(state, self._nearest(tables, state), gap, turn, limits)
            yaw = yaw + whole_turn
        return first, state[..., :2], yaw

    def _nearest(self, tables: _Lookup, state: Tensor) -> _Nearest:
        """Return the nearest places of outlines to the first two numbers of states (n, 1, ...)."""
        numbers = torch.clamp(state[..., :2] @ tables.slopes + tables.offsets, min=_LEAST).reshape(-1, 4, CORNERS)
        squares = (numbers * numbers).sum(dim=1, keepdim=True)
        edge = squares.argmin(dim=2, keepdim=True)  # (n, 1, 1)
        numbers = torch.gather(numbers, 2, edge + self.row_of_numbers)  # (n, 4, 1)
        ways = torch.gather(tables.ways, 1, edge + self.row_of_ways).reshape(-1, 4, 2)
        length = torch.sqrt(squares.amin(dim=2, keepdim=True))
        inside = numbers[:, 3:]
        return _Nearest((numbers * ways).sum(dim=1, keepdim=True) / length, length - inside - inside)


class _Half(nn.Module):
    """Half of a step: forces at a contact, and the vectors of a row after the motion that they cause.

    Vectors v of a row are held spread, as v and -i v, so that the product with the conjugate of a number r is the sum
    of both, times the real and the imaginary part of r.
    """

    def __init__(self, given: int, returned: int, advance: Matrix, motion: Matrix, pushed: Matrix) -> None:
        """Create the constants.

        Args:
            given: number of vectors that are given.
            returned: number of vectors that are returned.
            advance: (2 given, 4) from given vectors to the place and the advance of the tip.
            motion: (2 given, 2 returned) from given vectors to returned ones, if nothing was pushed.
            pushed: (2, 2 returned) what the motion of the contact adds to them.
        """
        super().__init__()
        spread, summed = _spread(given), _summed(given)
        spread_back, summed_back = _spread(returned), _summed(returned)
        self.spread = nn.Buffer(spread, persistent=False)
        self.into = nn.Buffer(_parts(given, 1.0), persistent=False)
        self.out_of = nn.Buffer(_parts(returned, -1.0), persistent=False)
        self.advance = nn.Buffer(summed @ torch.tensor(advance), persistent=False)
        self.motion = nn.Buffer(summed @ torch.tensor(motion) @ spread_back, persistent=False)
        self.pushed = nn.Buffer(torch.tensor(pushed) @ spread_back, persistent=False)
        self.again = nn.Buffer(summed_back @ spread_back, persistent=False)
        quarter = torch.full((2 * returned,), -0.5 * math.pi)  # a sine is the cosine of an angle less a quarter
        self.phases = nn.Buffer(torch.cat([torch.zeros(2 * returned), quarter]), persistent=False)

    def forward(
        self, state: Tensor, found: _Nearest, gap: Tensor, turned: Tensor | None, limits: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Return the vectors (n, 1, 4 returned) after the motion, and the turn (n, 1, 1) since the step began.

        Args:
            state: (n, 1, 4 given) vectors, spread.
            found: the contacts.
            gap: (n, 1, 1) to be closed.
            turned: (n, 1, 1) the part of the turn that the given vectors have seen. None: they have seen none.
            limits: (n, 1, 1) the friction, and its negative.
        """
        held = state * (found.normal @ self.into)  # in the frame of the contact, once summed
        place, t, into, y = torch.split(held @ self.advance, 1, dim=2)
        b, x = place + found.distance, into - gap
        lever = b * x + t * y
        slope = (y + t * lever) / torch.clamp(x + b * lever, min=TINY)
        slope = torch.maximum(torch.minimum(slope, limits[0]), limits[1])
        moment = b * slope - t
        force = torch.relu(x / (1.0 - t * moment))  # a tip does not pull
        turn = force * moment
        moved = held @ self.motion + torch.cat([force, force * slope], dim=2) @ self.pushed
        out = (moved * (found.normal @ self.out_of)) @ self.again
        return (out * torch.cos((turn if turned is None else turn - turned) + self.phases)) @ self.again, turn


def _spread(vectors: int) -> Tensor:
    """Return the matrix (2 m, 4 m) that spreads vectors v as v and -i v."""
    both = torch.tensor([[1.0, 0.0], [0.0, 1.0]]), torch.tensor([[0.0, -1.0], [1.0, 0.0]])
    return torch.cat([torch.kron(torch.eye(vectors), part) for part in both], dim=1)


def _summed(vectors: int) -> Tensor:
    """Return the matrix (4 m, 2 m) that sums both parts of spread vectors."""
    return torch.cat([torch.eye(2 * vectors)] * 2, dim=0)


def _parts(vectors: int, sign: float) -> Tensor:
    """Return the matrix (2, 4 m) from a number to its real part beside each v, and its imaginary one beside -i v."""
    return torch.kron(torch.diag(torch.tensor([1.0, sign])), torch.ones(1, 2 * vectors))
