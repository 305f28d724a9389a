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
    x, y, cosine, sine = circular(pusher).unbind(-1)
    x_m, y_m = (at * float(known.input_std[axis]) + float(known.input_mean[axis]) for axis, at in enumerate((x, y)))
    scale_m = float(known.input_std[0])
    along, aside = -(x_m * cosine + y_m * sine), x_m * sine - y_m * cosine
    return torch.stack(
        [x, y, cosine, sine, along / scale_m, aside / scale_m, torch.sqrt(along**2 + aside**2) / scale_m], dim=-1
    )


def from_push_frame(mean: Tensor, pusher: Tensor) -> Tensor:
    """Turn means (..., 3) in the frame of each push into normalised poses of the object.

    The frame of the push (..., 3) has its first axis along the push. A mean of 0 is an object at rest.
    """
    known = published_normalisation()
    _, _, cosine, sine = circular(pusher).unbind(-1)
    along, aside, turn = mean.unbind(-1)
    unit_m = float(known.output_std[0])
    moved = (cosine * along - sine * aside) * unit_m, (sine * along + cosine * aside) * unit_m
    x, y = ((at_m - float(known.output_mean[axis])) / float(known.output_std[axis]) for axis, at_m in enumerate(moved))
    return torch.stack([x, y, turn - float(known.output_mean[2] / known.output_std[2])], dim=-1)
