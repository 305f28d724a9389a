"""Push poses as inputs and outputs of networks.

Angles are wrapped to (-pi, pi], or given as cosine and sine, which do not jump at pi. The frame of a push has its
first axis along the push.
"""

import math
from enum import StrEnum
from typing import Final

import torch
from torch import Tensor

from training.omnipush.published import published_normalisation


class PushForm(StrEnum):
    """Form in which the pose of a push enters the first layer."""

    RAW = "raw"  # the paper's: x, y, angle
    CIRCULAR = "circular"  # cosine and sine of the angle
    PUSH_FRAME = "push-frame"  # also how the push passes the centre; the mean is in the frame of the push


FEATURES_ADDED: Final = {PushForm.RAW: 0, PushForm.CIRCULAR: 1, PushForm.PUSH_FRAME: 4}


# Constant matrices of ``products``, and of their sums.
_VECTORS: Final = ((1.0, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0, 1.0))
_DIRECTIONS: Final = ((1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 1.0, 0.0))
_PASSING: Final = ((-1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))  # the way to the centre, and the offset
_TURNING_BACK: Final = ((1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))  # the other way round
_TURNING: Final = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, 1.0))  # a vector of the push frame, in the object's


def wrapped(angle_rad: Tensor) -> Tensor:
    """Wrap angles to (-pi, pi]: the torch form of ``service.pushing.poses.wrap_angles``, which exports to ONNX."""
    return angle_rad - 2.0 * math.pi * torch.ceil((angle_rad - math.pi) / (2.0 * math.pi))


def features(pusher: Tensor, form: PushForm) -> Tensor:
    """Return normalised pusher poses (..., 3) in a form, (..., 3 + FEATURES_ADDED)."""
    if form is PushForm.RAW:
        return pusher
    return circular(pusher) if form is PushForm.CIRCULAR else in_push_frame(pusher)


def circular(pusher: Tensor) -> Tensor:
    """Replace the angle of normalised pusher poses (..., 3) by its cosine and sine, (..., 4).

    The paper feeds the normalised angle. It jumps from pi to -pi where the world does not, so a network has to learn
    the same outcomes twice, once on either side of the jump.
    """
    known = published_normalisation()
    position, angle = torch.split(pusher, [2, 1], dim=-1)
    angle_rad = angle * float(known.input_std[2]) + float(known.input_mean[2])
    return torch.cat([position, torch.cos(angle_rad), torch.sin(angle_rad)], dim=-1)


def in_push_frame(pusher: Tensor) -> Tensor:
    """Add to circular poses of pushes (..., 3) how each passes the centre, normalised: (..., 7).

    The path to the point nearest to the centre (negative if it lies behind), the signed distance of the line from the
    centre, and the distance of the start. A push misses if the line is far from the centre, or the centre behind.
    """
    known = published_normalisation()
    posed = circular(pusher)
    position, direction = torch.split(posed, [2, 2], dim=-1)
    place_m = position * posed.new_tensor(known.input_std[:2]) + posed.new_tensor(known.input_mean[:2])
    passing = products(place_m, direction) @ (posed.new_tensor(_PASSING) / float(known.input_std[0]))
    return torch.cat([posed, passing, torch.linalg.vector_norm(passing, dim=-1, keepdim=True)], dim=-1)


def from_push_frame(mean: Tensor, pusher: Tensor) -> Tensor:
    """Turn means (..., 3) in the frame of each push into normalised poses of the object.

    The frame of the push (..., 3) has its first axis along the push. A mean of 0 is an object at rest.
    """
    known = published_normalisation()
    _, direction = torch.split(circular(pusher), [2, 2], dim=-1)
    moved, turn = torch.split(mean, [2, 1], dim=-1)
    unit = float(known.output_std[0]) / mean.new_tensor(known.output_std[:2])
    place = products(moved, direction) @ (mean.new_tensor(_TURNING) * unit)
    return torch.cat([place, turn], dim=-1) - mean.new_tensor(known.output_mean) / mean.new_tensor(known.output_std)


def into_push_frame(outcome: Tensor, pusher: Tensor) -> Tensor:
    """Turn normalised poses of the object (..., 3) into the frames of their pushes: the inverse of ``from_push_frame``.

    An object at rest is 0.
    """
    known = published_normalisation()
    _, direction = torch.split(circular(pusher), [2, 2], dim=-1)
    rest = outcome + outcome.new_tensor(known.output_mean) / outcome.new_tensor(known.output_std)
    moved, turn = torch.split(rest, [2, 1], dim=-1)
    unit = outcome.new_tensor(known.output_std[:2]) / float(known.output_std[0])
    return torch.cat([products(moved * unit, direction) @ outcome.new_tensor(_TURNING_BACK), turn], dim=-1)


def products(vectors: Tensor, directions: Tensor) -> Tensor:
    """Return the products x cos, y sin, x sin, y cos (..., 4) of vectors and directions (..., 2).

    Sums of them turn vectors. As products by constants they are few operators of a graph, where each column is three.
    """
    return (vectors @ vectors.new_tensor(_VECTORS)) * (directions @ vectors.new_tensor(_DIRECTIONS))
