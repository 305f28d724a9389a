"""Angles as inputs and outputs of networks: wrapped to (-pi, pi], or as cosine and sine, which do not jump at pi."""

import math

import torch
from torch import Tensor

from training.omnipush.published import published_normalisation


def wrapped(angle_rad: Tensor) -> Tensor:
    """Wrap angles to (-pi, pi]: the torch form of ``service.pushing.poses.wrap_angles``, which exports to ONNX."""
    return angle_rad - 2.0 * math.pi * torch.ceil((angle_rad - math.pi) / (2.0 * math.pi))


def circular(pusher: Tensor) -> Tensor:
    """Replace the angle of normalised pusher poses (..., 3) by its cosine and sine, (..., 4).

    The paper feeds the normalised angle. It jumps from pi to -pi where the world does not, so a network has to learn
    the same outcomes twice, once on either side of the jump.
    """
    known = published_normalisation()
    position, angle = torch.split(pusher, [2, 1], dim=-1)
    angle_rad = angle * float(known.input_std[2]) + float(known.input_mean[2])
    return torch.cat([position, torch.cos(angle_rad), torch.sin(angle_rad)], dim=-1)
