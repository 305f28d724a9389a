"""Edges of outlines in tensors, and the exact first contact of a tip with them.

The equations are those of ``service.pushing.first_contact``. Lengths are in sizes of the object, from its centre of
mass, in the caller's axes. Only operators are used that ``service.model.onnx_graph`` accepts.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor

TINY: Final = 1e-6
FAR: Final = 1e4  # sizes: where edges lie that fill an outline up
LARGEST: Final = 1e6
TOUCH: Final = 1e-5  # sizes: rounding must not turn a touch into a miss


class Edges(NamedTuple):
    """Edges of objects, in sizes from the centre of mass, in the caller's axes. One that fills up is far away."""

    unit: Tensor  # (g, 64, 2) along each edge
    outward: Tensor  # (g, 64, 2) its normal
    along: Tensor  # (g, 64) to be added to the place along an edge, so that its middle is 0
    height: Tensor  # (g, 64) to be added to the place along its normal, so that the edge is at 0
    half: Tensor  # (g, 64) half of its length


def edges_of(outline: Tensor, body: Tensor) -> Edges:
    """Return the edges of outlines (g, 64, 2) in m."""
    corners = (outline - body[:, None, 3:5]) / body[:, None, 2:3]
    vector = torch.cat([corners[:, 1:], corners[:, :1]], dim=1) - corners
    length = torch.linalg.vector_norm(vector, dim=2, keepdim=True)
    unit = vector / torch.clamp(length, min=TINY)
    outward = torch.cat([unit[..., 1:], -unit[..., :1]], dim=2)
    half = 0.5 * length[..., 0]
    along, height = -(corners * unit).sum(dim=2) - half, -(corners * outward).sum(dim=2)
    half = torch.where(half < TINY, torch.full_like(half, -FAR), half)
    return Edges(unit, outward, along, height, half)


def first_contact(edges: Edges, start: Tensor, ahead: Tensor, radius: Tensor) -> Tensor:
    """Return the travel (n, 1) from starts (n, 2) along unit vectors to the first contact, ``LARGEST`` for a miss."""
    both = torch.stack([start, ahead], dim=2)  # (n, 2, 2)
    along, drift = torch.unbind(edges.unit @ both, dim=2)  # (n, 64)
    height, climb = torch.unbind(edges.outward @ both, dim=2)
    along, height = along + edges.along, height + edges.height
    far = torch.full_like(height, LARGEST)
    faces = climb < -TINY  # edges that the tip nears
    to_edge = (height - radius) / torch.where(faces, -climb, torch.ones_like(climb))
    met = torch.abs(along + to_edge * drift) <= edges.half
    to_edge = torch.where(faces & (to_edge >= 0.0) & met, to_edge, far)
    beside = along + edges.half  # the corner at the start of an edge, seen from it
    across = drift * height - climb * beside
    room = radius * radius - across * across
    to_corner = -(drift * beside + climb * height) - torch.sqrt(torch.relu(room))
    to_corner = torch.where((room >= 0.0) & (to_corner >= 0.0), to_corner, far)
    travel = torch.minimum(to_edge, to_corner).amin(dim=1, keepdim=True)
    excess = torch.relu(torch.abs(along) - edges.half)
    clearance = torch.sqrt((excess * excess + height * height).amin(dim=1, keepdim=True))
    return torch.where(clearance <= radius + TOUCH, torch.zeros_like(travel), travel)
