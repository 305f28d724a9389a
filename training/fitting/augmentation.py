"""Augmentation of a batch by the laws of physics: symmetric scenes, and pushes without contact.

- Turn: an object's frame depends on which side is called the first. A scene turned by a quarter is therefore a scene
  of the object with its sides renumbered.
- Mirror: shapes and weights are symmetric about their side's axis. A mirrored scene is therefore a scene of the object
  with sides 2 and 4 swapped.
- No contact: a push that misses the object does not move it.

The published data hold each object under a single descriptor, and almost no push without contact.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.pushing.contexts import BITS_PER_SIDE, SIDES
from service.pushing.poses import PUSH_LENGTH_M, wrap_angles
from training.fitting.samples import Samples
from training.networks.angles import wrapped
from training.omnipush.published import published_normalisation

# The greatest distance from an object's centre to its edge, plus the pusher's radius. Omnipush's pushes start outside.
OBJECT_REACH_M: Final = 0.0755
FURTHEST_START_M: Final = 0.300
DRAWN_SHARE: Final = 0.25  # of the views of objects that have camera views
Floats = npt.NDArray[np.float64]


def augmented(samples: Samples, symmetries: bool, no_contact: float, rng: np.random.Generator) -> Samples:
    """Turn and mirror each object of a batch at random, and replace a share of its pushes by pushes without contact.

    An object with camera views is seen by one of them, or as drawn.

    The random numbers depend on the generator alone.
    """
    objects = len(samples.inputs)
    if samples.views is not None:
        cameras = rng.integers(1, samples.views.shape[1], size=objects)
        drawn = rng.uniform(size=objects) < DRAWN_SHARE
        samples = samples.seen(torch.from_numpy(np.where(drawn, 0, cameras)))
    if symmetries:
        quarter_turns, mirrored = rng.integers(SIDES, size=objects), rng.integers(2, size=objects)
        samples = in_symmetric_frames(samples, torch.from_numpy(quarter_turns), torch.from_numpy(mirrored))
    if no_contact > 0.0:
        chosen = rng.uniform(size=samples.valid.shape) < no_contact
        pushers = no_contact_pushers(chosen.size, rng).reshape(*chosen.shape, 3)
        samples = _with_no_contact(samples, torch.from_numpy(chosen), pushers)
    return samples


def in_symmetric_frames(samples: Samples, quarter_turns: Tensor, mirrored: Tensor) -> Samples:
    """Mirror the samples of each object about its x axis where ``mirrored`` is 1, then turn them by +90 degree steps.

    Both are (objects,) integers. Contexts follow: indicators by sides, views as images with x right and y up.
    """
    device = samples.inputs.device
    quarter_turns, mirrored = quarter_turns.to(device), mirrored.to(device)
    known = published_normalisation()
    handedness = 1.0 - 2.0 * mirrored.float()
    cosine, sine = torch.tensor([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]], device=device)[:, quarter_turns]
    # (objects, 2, 2), the transpose of turn @ mirror: rows of positions are multiplied from the left
    change = torch.stack([cosine, sine, -sine * handedness, cosine * handedness], dim=-1).reshape(-1, 2, 2)

    def moved(poses: Tensor, mean: Floats, std: Floats, quarters: Tensor) -> Tensor:
        """Return normalised poses (objects, pushes, 3) in the new frames."""
        centre, scale = (torch.tensor(value, dtype=torch.float32, device=device) for value in (mean, std))
        position, angle = torch.split(poses * scale + centre, [2, 1], dim=-1)
        turned = wrapped(handedness[:, None, None] * angle + quarters[:, None, None] * (math.pi / 2.0))
        return (torch.cat([position @ change, turned], dim=-1) - centre) / scale

    return replace(
        samples,
        inputs=moved(samples.inputs, known.input_mean, known.input_std, quarter_turns),
        targets=moved(samples.targets, known.output_mean, known.output_std, torch.zeros_like(quarter_turns)),
        context=_symmetric_context(samples.context, quarter_turns, mirrored),
    )


def no_contact_pushers(count: int, rng: np.random.Generator) -> Floats:
    """Draw pusher poses (count, 3), in m, m, rad, whose whole path misses every object.

    Starts lie between Omnipush's starts and ``FURTHEST_START_M``, near ones more often. Directions are uniform, but a
    path that would come within ``OBJECT_REACH_M`` of the centre is reversed.
    """
    radius = OBJECT_REACH_M + (FURTHEST_START_M - OBJECT_REACH_M) * rng.uniform(size=count) ** 3
    bearing, angle = rng.uniform(-np.pi, np.pi, (2, count))
    start = radius[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    along = np.clip(
        -radius * np.cos(angle - bearing), 0.0, PUSH_LENGTH_M
    )  # of the path, to the point nearest to the centre
    nearest = start + along[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    touching = np.hypot(*nearest.T) < OBJECT_REACH_M
    angle = np.where(touching, angle + np.pi, angle)
    return np.column_stack([start, wrap_angles(angle)])


def _with_no_contact(samples: Samples, chosen: Tensor, pushers: Floats) -> Samples:
    """Replace the chosen pushes (objects, pushes) by these pushers, and their outcomes by rest."""
    known = published_normalisation()
    inputs = torch.from_numpy((pushers - known.input_mean) / known.input_std).to(samples.inputs)
    rest = torch.from_numpy(-known.output_mean / known.output_std).to(samples.targets)
    where = chosen.to(samples.inputs.device)[..., None]
    return replace(
        samples,
        inputs=torch.where(where, inputs, samples.inputs),
        targets=torch.where(where, rest, samples.targets),
    )


def _symmetric_context(context: Tensor, quarter_turns: Tensor, mirrored: Tensor) -> Tensor:
    """Return the contexts of the objects mirrored, then turned. Contexts (objects, 0) stay as they are."""
    if context.shape[-1] == 0:
        return context
    if context.dim() == 2:
        sides = (
            torch.arange(SIDES, device=context.device) - quarter_turns[:, None]
        )  # (objects, 4): the former place of each side
        sides = torch.where(mirrored[:, None] > 0, -sides, sides) % SIDES
        by_side = context.reshape(-1, SIDES, BITS_PER_SIDE)
        return by_side.take_along_dim(sides[..., None], dim=1).flatten(1)
    upright = torch.where(mirrored[:, None, None, None] > 0, context.flip(-2), context)
    turned = torch.stack([torch.rot90(upright, quarters, (-2, -1)) for quarters in range(SIDES)])
    return turned[quarter_turns, torch.arange(len(context), device=context.device)]
