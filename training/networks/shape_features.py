"""Inputs of a shape network: contexts of objects, and pushes as mechanics sees them, without a unit of length.

A network predicts the residual of mechanics in the push frame. Its unit grows with the rest of the push, so that short
and long pushes count alike.
"""

from typing import Final

import torch
from torch import Tensor

from service.pushing.shape_context import SILHOUETTE_SIZE
from training.networks.mechanics import Mechanics

BODY_INPUTS: Final = 8
CONTEXT_INPUTS: Final = SILHOUETTE_SIZE**2 + BODY_INPUTS
PUSH_INPUTS: Final = 22
RESIDUAL: Final = 0.3  # of the rest of the push: what mechanics is off by, in sizes and rad
_LONG: Final = 0.2  # a push of many sizes slides off, so its residual grows more slowly
_LEAST_LEFT: Final = 0.02  # sizes


def context_inputs(silhouette: Tensor, body: Tensor) -> Tensor:
    """Return the contexts (g, 1032) of objects: silhouettes (g, 1, 32, 32), and what is known of bodies (g, 11)."""
    size = body[:, 2:3]
    centre = (body[:, 3:5] - body[:, 0:2]) / size
    known = torch.cat([centre, body[:, 5:6], body[:, 6:7] / size, body[:, 7:9], body[:, 9:10] / size, body[:, 10:]], 1)
    return torch.cat([silhouette.flatten(1), known], dim=1)


def push_inputs(found: Mechanics, pusher: Tensor, body: Tensor) -> Tensor:
    """Return the inputs (n, 22) of pushes (n, 4) of objects with bodies (n, 11): contact, body and motion.

    Places and directions are in the push frame and in sizes. The direction of the push is that in the object frame.
    """
    size = body[:, 2:3]
    cos, sin = torch.cos(pusher[:, 2:3]), torch.sin(pusher[:, 2:3])
    x, y = torch.split((body[:, 3:5] - body[:, 0:2]) / size, 1, dim=1)
    centre = torch.cat([cos * x + sin * y, cos * y - sin * x], dim=1)
    left = found.left[:, None]
    lever = found.point - centre
    turning = lever[:, :1] * found.normal[:, 1:] - lever[:, 1:] * found.normal[:, :1]
    rate = found.motion / torch.clamp(left, min=_LEAST_LEFT)
    return torch.cat(
        [
            torch.log1p(left),
            found.point,
            found.normal,
            centre,
            lever[:, 1:],
            turning,
            rate,
            found.motion[:, 2:],
            torch.sqrt(left + _LEAST_LEFT),
            body[:, 6:7] / size,
            2.0 * body[:, 7:8],
            4.0 * body[:, 9:10] / size,
            cos,
            sin,
            body[:, 5:6],
            body[:, 8:9],
            body[:, 10:11],
        ],
        dim=1,
    )


def residual_unit(left: Tensor) -> Tensor:
    """Return the unit (..., 1) of residuals of pushes whose rest after the first contact is (...,), in sizes."""
    rest = torch.clamp(left, min=_LEAST_LEFT)
    return (RESIDUAL * rest / (1.0 + _LONG * rest))[..., None]
