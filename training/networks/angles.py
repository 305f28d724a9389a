"""Directions as networks meet them: wrapped into one turn, or as a point of the unit circle, which has no seam."""

import math

import torch
from torch import Tensor

from training.omnipush.published import published_normalisation


def wrapped(angle_rad: Tensor) -> Tensor:
    """The same directions in (-pi, pi]."""
    return angle_rad - 2.0 * math.pi * torch.ceil((angle_rad - math.pi) / (2.0 * math.pi))


def circular(pusher: Tensor) -> Tensor:
    """Normalised pusher poses (..., 3) with cosine and sine of their angle in its place, (..., 4).

    The paper feeds the normalised angle, whose jump from pi to -pi is none in the world: a network has to learn on
    either side of it what the other side already shows.
    """
    known = published_normalisation()
    position, angle = torch.split(pusher, [2, 1], dim=-1)
    angle_rad = angle * float(known.input_std[2]) + float(known.input_mean[2])
    return torch.cat([position, torch.cos(angle_rad), torch.sin(angle_rad)], dim=-1)
