"""Edges of outlines in tensors, and the exact first contact of a tip with them.

The equations are those of ``service.pushing.first_contact``. Lengths are in sizes of the object, from its centre of
mass, in the caller's axes. Only operators are used that ``service.model.onnx_graph`` accepts, and as few as possible:
what is linear is a product with a constant matrix.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from service.pushing.shape_context import CORNERS

TINY: Final = 1e-6
FAR: Final = 1e4  # sizes: where edges lie that fill an outline up
LARGEST: Final = 1e6
TOUCH: Final = 1e-5  # sizes: rounding must not turn a touch into a miss
INSIDE: Final = 1.001  # of two edges that share a corner, the one that a place is outside of counts as nearer
# Numbers of an edge: x and y of the unit vector along it, and of its outward normal, what is added to a place along the
# edge, so that its middle is at 0, and along the normal, so that the edge is at 0, and half of its length.
_UNIT_X, _UNIT_Y, _OUT_X, _OUT_Y, _ALONG, _HEIGHT, _HALF = range(7)

Column = dict[int, float]  # weights of these numbers


class Edges(NamedTuple):
    """Edges of g objects. One that fills an outline up is far away."""

    lines: Tensor  # (g, 3, 128) to multiply (x, y, 1) with: the place along each edge, and its height above each edge
    numbers: Tensor  # (g, 3, 256) likewise, how far a place is beyond the end, before the start, outside, and inside
    ways: Tensor  # (g, 64, 8) unit vectors to the edge from places that are so: in the order of ``numbers``
    half: Tensor  # (g, 1, 64) half of each length


class OutlineEdges(nn.Module):
    """Edges of outlines. It has no weights."""

    def __init__(self) -> None:
        """Create the constants."""
        super().__init__()
        one, following = torch.eye(CORNERS), torch.eye(CORNERS).roll(1, dims=1)
        self.differences = nn.Buffer(following - one, persistent=False)
        self.middles = nn.Buffer(0.5 * (following + one), persistent=False)
        self.directions = nn.Buffer(torch.tensor([[1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 1.0, 0.0]]), persistent=False)
        self.twice = nn.Buffer(torch.eye(2).repeat(1, 2), persistent=False)
        self.products = nn.Buffer(torch.tensor([[-1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [0.0, -1.0]]), persistent=False)
        self.to_lines = nn.Buffer(
            _columns({_UNIT_X: 1}, {_OUT_X: 1}, {_UNIT_Y: 1}, {_OUT_Y: 1}, {_ALONG: 1}, {_HEIGHT: 1}), persistent=False
        )
        sides = ((_UNIT_X, _OUT_X), (_UNIT_Y, _OUT_Y), (_ALONG, _HEIGHT))
        numbers: list[Column] = []
        for along, height in sides:
            shift: Column = {_HALF: -1.0} if along == _ALONG else {}
            numbers += [{along: 1.0, **shift}, {along: -1.0, **shift}, {height: 1.0}, {height: -INSIDE}]
        self.to_numbers = nn.Buffer(_columns(*numbers), persistent=False)
        ways: list[Column] = [{_UNIT_X: -1.0}, {_UNIT_Y: -1.0}, {_UNIT_X: 1.0}, {_UNIT_Y: 1.0}]
        ways += [{_OUT_X: -1.0}, {_OUT_Y: -1.0}] * 2
        self.to_ways = nn.Buffer(_columns(*ways), persistent=False)

    def forward(self, outline: Tensor, centre: Tensor, size: Tensor) -> Edges:
        """Return the edges of outlines (g, 64, 2) about centres of mass (g, 1, 2), in sizes (g, 1, 1), all in m."""
        corners = (outline - centre) / size
        vector = self.differences @ corners
        length = torch.sqrt((vector * vector).sum(dim=2, keepdim=True))
        directions = (vector / torch.clamp(length, min=TINY)) @ self.directions
        offsets = ((self.middles @ corners @ self.twice) * directions) @ self.products
        half = torch.where(length < TINY, -FAR, 0.5 * length)
        parts = torch.cat([directions, offsets, half], dim=2)  # (g, 64, 7)

        def rows(columns: Tensor) -> Tensor:
            """Return 3 m columns as (g, 3, 64 m)."""
            return (parts @ columns).transpose(1, 2).reshape(-1, 3, CORNERS * (columns.shape[1] // 3))

        return Edges(rows(self.to_lines), rows(self.to_numbers), parts @ self.to_ways, half.transpose(1, 2))


def _columns(*columns: Column) -> Tensor:
    """Return the matrix (7, m) of weighted sums of the parts of an edge."""
    found = torch.zeros(7, len(columns))
    for place, column in enumerate(columns):
        for part, weight in column.items():
            found[part, place] = weight
    return found


def first_contact(edges: Edges, start: Tensor, ahead: Tensor, radius: Tensor) -> Tensor:
    """Return the travel (n, 1, 1) of tips to the first contact, ``LARGEST`` for a miss.

    Args:
        edges: of the object of each tip.
        start: (n, 1, 2) where tips start.
        ahead: (n, 1, 2) unit vectors along their way.
        radius: (n, 1, 1) of the tips.
    """
    slopes, offsets = edges.lines[:, :2], edges.lines[:, 2:]
    place = start @ slopes + offsets
    along, height = torch.split(place, CORNERS, dim=2)  # (n, 1, 64)
    drift, climb = torch.split(ahead @ slopes, CORNERS, dim=2)
    faces = climb < -TINY  # edges that the tip nears
    to_edge = (radius - height) / torch.where(faces, climb, -1.0)
    met = torch.abs(along + to_edge * drift) <= edges.half
    to_edge = torch.where(faces & (to_edge >= 0.0) & met, to_edge, LARGEST)
    beside = along + edges.half  # the corner at the start of an edge, seen from it
    across = drift * height - climb * beside
    room = radius * radius - across * across
    to_corner = -(drift * beside + climb * height) - torch.sqrt(torch.relu(room))
    to_corner = torch.where((room >= 0.0) & (to_corner >= 0.0), to_corner, LARGEST)
    travel = torch.minimum(to_edge, to_corner).amin(dim=2, keepdim=True)
    excess = torch.relu(torch.abs(along) - edges.half)
    clearance = torch.sqrt((excess * excess + height * height).amin(dim=2, keepdim=True))
    return torch.where(clearance <= radius + TOUCH, 0.0, travel)


def clearance(pusher: Tensor, corners: Tensor, radius: Tensor) -> Tensor:
    """Return how near tips come to outlines that they miss, (n, 1) in m.

    Args:
        pusher: (n, 4) pushes in the frame of the corners.
        corners: (n, 64, 2) of the outline of each push, in m.
        radius: (n, 1) of the tips, in m.
    """
    cos, sin, length = torch.cos(pusher[:, 2:3]), torch.sin(pusher[:, 2:3]), pusher[:, 3:4]
    x, y = corners[:, :, 0] - pusher[:, :1], corners[:, :, 1] - pusher[:, 1:2]
    along, across = cos * x + sin * y, cos * y - sin * x
    beyond = along - torch.minimum(torch.relu(along), length)  # a corner is nearest to the way, or an edge to its ends
    to_corner = beyond * beyond + across * across
    edge_x, edge_y = along.roll(-1, 1) - along, across.roll(-1, 1) - across
    square = torch.clamp(edge_x * edge_x + edge_y * edge_y, min=TINY * TINY)
    nearest = [to_corner.amin(dim=1, keepdim=True)]
    for end in (torch.zeros_like(length), length):
        ahead = end - along
        share = torch.clamp((ahead * edge_x - across * edge_y) / square, 0.0, 1.0)
        to_x, to_y = ahead - share * edge_x, across + share * edge_y
        nearest.append((to_x * to_x + to_y * to_y).amin(dim=1, keepdim=True))
    return torch.relu(torch.sqrt(torch.cat(nearest, dim=1).amin(dim=1, keepdim=True)) - radius)
