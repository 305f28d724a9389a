"""Samples to fit and evaluate networks on: normalised tensors by object, with the record of their origin."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from service.errors import DataError
from service.model.tensors import ContextKind, FloatArray
from training.networks.push_network import Shape
from training.omnipush.published import Split, published_normalisation
from training.omnipush.pushes import Pushes, read_folder
from training.omnipush.views import camera_views_beside, read_camera_views, read_views, views_beside

AnyArray = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Samples:
    """Inputs and targets of objects (in the paper's regression: of parameter sets), as the networks take them."""

    inputs: Tensor  # (objects, samples, inputs)
    targets: Tensor  # (objects, samples, outputs)
    valid: Tensor  # (objects, samples): 1 for a sample, 0 for padding
    context: Tensor  # (objects, *context)
    target_std: tuple[float, ...]  # the unit of each output (pushes: in metres, metres, radians)
    views: Tensor | None = None  # (objects, views, *context): the context and camera views of the same object

    @classmethod
    def of(cls, pushes: Pushes, kind: ContextKind) -> "Samples":
        """Normalise pushes with the published statistics, and add their contexts of this kind.

        Raises:
            DataError: the kind is visual and the pushes were read without views.
        """
        known = published_normalisation()
        inputs = (pushes.pushers - known.input_mean) / known.input_std
        targets = (pushes.outcomes - known.output_mean) / known.output_std
        found = cls.of_arrays(inputs, targets, pushes.valid, contexts(pushes, kind), tuple(known.output_std.tolist()))
        if kind is not ContextKind.VISUAL or pushes.camera_views is None:
            return found
        cameras = torch.from_numpy(pushes.camera_views.astype(np.float32) / np.float32(255.0))
        return replace(found, views=torch.cat([found.context[:, None], cameras], dim=1))

    @classmethod
    def of_arrays(
        cls, inputs: AnyArray, targets: AnyArray, valid: AnyArray, context: AnyArray, target_std: tuple[float, ...]
    ) -> "Samples":
        """Convert arrays to float32 tensors."""
        tensors = [torch.from_numpy(array.astype(np.float32)) for array in (inputs, targets, valid, context)]
        return cls(tensors[0], tensors[1], tensors[2], tensors[3], target_std)

    @property
    def shape(self) -> Shape:
        """Return the shape of a network for these samples."""
        return Shape(tuple(self.context.shape[1:]), self.inputs.shape[-1], self.targets.shape[-1])

    def seen(self, views: Tensor) -> "Samples":
        """Return the samples with one of the views of each object, by its number (objects,), as its context.

        Raises:
            DataError: there are no other views.
        """
        if self.views is None:
            raise DataError("the objects were read without camera views; read them with camera views")
        return replace(self, context=self.views[torch.arange(len(views)), views])

    def select(self, objects: Tensor) -> "Samples":
        """Return the samples of some objects, in this order."""
        return self._map(lambda tensor: tensor[objects])

    def singly(self) -> "Samples":
        """Return every sample as an object of its own, with its object's context and without padding."""
        present = self.valid > 0
        return Samples(
            self.inputs[present][:, None],
            self.targets[present][:, None],
            self.valid[present][:, None],
            self.context.repeat_interleave(present.sum(dim=1), dim=0),
            self.target_std,
        )

    def to(self, device: torch.device) -> "Samples":
        """Copy the samples to a device."""
        return self._map(lambda tensor: tensor.to(device))

    def _map(self, change: Callable[[Tensor], Tensor]) -> "Samples":
        inputs, targets, valid, context = map(change, (self.inputs, self.targets, self.valid, self.context))
        views = None if self.views is None else change(self.views)
        return Samples(inputs, targets, valid, context, self.target_std, views)


def contexts(pushes: Pushes, kind: ContextKind) -> FloatArray:
    """Return the context of each object: (objects, 0), (objects, 36), or (objects, 1, 32, 32) in 0..1.

    Raises:
        DataError: the kind is visual and the pushes were read without views.
    """
    if kind in (ContextKind.NONE, ContextKind.SUPPORT):  # a support is drawn from the pushes
        return np.zeros((len(pushes.descriptors), 0), dtype=np.float32)
    if kind is ContextKind.INDICATOR:
        return pushes.indicators
    if pushes.views is None:
        raise DataError(f"the pushes of {pushes.source} were read without top-down views; a visual context needs them")
    return pushes.views.astype(np.float32) / np.float32(255.0)  # as VisualContext.tensor does


@dataclass(frozen=True)
class TrainingData:
    """Data of a run: samples to train on, samples held out, and the record of their origin."""

    train: Samples
    held_out: Samples
    origin: dict[str, str]  # source and sha256, also of the held-out surface if it is another one

    @classmethod
    def of(cls, split: Split, kind: ContextKind, pushes: Pushes, test_pushes: Pushes | None = None) -> "TrainingData":
        """Select the split's objects. Held-out objects come from ``test_pushes`` if the split tests on another surface.

        Raises:
            DataError: objects are missing.
        """
        held_out = pushes if test_pushes is None else test_pushes
        origin = {"source": pushes.source, "sha256": pushes.digest}
        if test_pushes is not None:
            origin |= {"held_out_source": test_pushes.source, "held_out_sha256": test_pushes.digest}
        train, test = pushes.select(split.train), held_out.select(split.test)
        return cls(Samples.of(train, kind), Samples.of(test, kind), origin)


def read_training_data(
    split: Split, kind: ContextKind, folder: Path, views: Path | None = None, camera_views: int = 0
) -> TrainingData:
    """Read a surface's folder for a split. If the split tests on another surface, its folder lies beside this one.

    Raises:
        DataError: files or objects are missing or damaged.
    """
    pushes = read_pushes(folder, kind, views, camera_views)
    if split.test_surface is None:
        return TrainingData.of(split, kind, pushes)
    other = read_pushes(folder.parent / split.test_surface, kind, views, camera_views)
    return TrainingData.of(split, kind, pushes, other)


def read_pushes(folder: Path, kind: ContextKind, views: Path | None = None, camera_views: int = 0) -> Pushes:
    """Read the pushes of a folder, and for visual contexts the views of their objects (see ``views_beside``).

    ``camera_views`` of each object are read from the folder beside that of the views.

    Raises:
        DataError: files are missing or damaged.
    """
    pushes = read_folder(folder)
    if kind is not ContextKind.VISUAL:
        return pushes
    drawings = views or views_beside(folder)
    pushes = pushes.with_views(read_views(drawings, pushes.descriptors))
    if camera_views == 0:
        return pushes
    return pushes.with_camera_views(read_camera_views(camera_views_beside(drawings), pushes.descriptors, camera_views))
