"""Folders of pushes in Omnipush's format: read into arrays, written, and exported in other variants.

A folder holds, for each object, ``<descriptor>..._X_3_not_norm.npy`` (pusher poses) and the same name with ``y`` for
``X`` (object poses after the push), both [pushes, 3] in metres, metres, radians in the object frame. An object that has
only normalised files is read with the published statistics. A folder that this project simulated also holds
``dataset.json``. Everything made from the folder carries the source that this file declares.
"""

import hashlib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from service.errors import DataError
from service.model.tensors import FloatArray
from service.pushing.contexts import INDICATOR_LENGTH, ObjectContext
from training.omnipush.declaration import copy_declaration, read_source
from training.omnipush.files import (
    PUSHES,
    Array,
    FilePair,
    FolderListing,
    Variant,
    check_lengths,
    list_folder,
    parse_pushes,
    read_pair,
    write_pair,
)
from training.omnipush.layout import surface_folders
from training.omnipush.npy_files import read_content
from training.omnipush.object_identity import find_objects
from training.omnipush.published import published_normalisation

PUSHER_SUFFIX: Final = Variant.RAW.pusher_suffix
OUTCOME_SUFFIX: Final = Variant.RAW.outcome_suffix


@dataclass(frozen=True)
class Pushes:
    """Pushes of some objects as dense arrays. Objects with fewer pushes are padded. ``valid`` marks the pushes."""

    descriptors: tuple[str, ...]
    pushers: FloatArray  # (objects, rows, 3), x_m, y_m, angle_rad
    outcomes: FloatArray  # (objects, rows, 3), x_m, y_m, yaw_rad
    valid: FloatArray  # (objects, rows), 1 for a push, 0 for padding
    source: str
    digest: str  # sha256 of the names and bytes of every file read
    views: npt.NDArray[np.uint8] | None = None  # (objects, 1, 32, 32), the visual context of each object, if read
    camera_views: npt.NDArray[np.uint8] | None = None  # (objects, views, 1, 32, 32), contexts from camera views

    @property
    def indicators(self) -> FloatArray:
        """Indicator context of each object, (objects, 36)."""
        found = [ObjectContext.from_descriptor(name).indicator() for name in self.descriptors]
        return np.array(found, dtype=np.float32).reshape(-1, INDICATOR_LENGTH)

    @property
    def count(self) -> int:
        """Number of pushes, without padding."""
        return int(self.valid.sum())

    def rows(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the pushers and outcomes of all objects, (n, 3) each, without padding."""
        present = self.valid > 0
        return self.pushers[present].astype(np.float64), self.outcomes[present].astype(np.float64)

    def select(self, descriptors: Sequence[str]) -> "Pushes":
        """Return the pushes of these objects only, in this order. Source and digest stay those of the whole folder.

        Objects are found up to rotation by whole sides, as in the benchmark. An object whose files have a turned
        descriptor keeps that descriptor, because its pushes are in the frame of that descriptor.

        Raises:
            DataError: An object is missing, or present twice.
        """
        found = find_objects(descriptors, self.descriptors)
        rows = [self.descriptors.index(descriptor) for descriptor in found]
        return replace(
            self,
            descriptors=tuple(found),
            pushers=self.pushers[rows],
            outcomes=self.outcomes[rows],
            valid=self.valid[rows],
            views=None if self.views is None else self.views[rows],
            camera_views=None if self.camera_views is None else self.camera_views[rows],
        )

    def with_views(self, views: npt.NDArray[np.uint8]) -> "Pushes":
        """Return the pushes with the visual context of each object, (objects, 1, 32, 32). The digest covers both."""
        digest = hashlib.sha256(self.digest.encode() + views.tobytes()).hexdigest()
        return replace(self, views=views, digest=digest)

    def with_camera_views(self, views: npt.NDArray[np.uint8]) -> "Pushes":
        """Return the pushes with camera views of each object, (objects, views, 1, 32, 32). The digest covers them."""
        digest = hashlib.sha256(self.digest.encode() + views.tobytes()).hexdigest()
        return replace(self, camera_views=views, digest=digest)


def read_folder(folder: Path) -> Pushes:
    """Read every object of a folder of pushes.

    Raises:
        DataError: A file is missing or broken. The message names it, the expected content and the remedy.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder of pushes; run 'make data' or name another folder")
    listing = list_folder(folder)
    if listing.faults:
        raise listing.faults[0]
    if not listing.pairs:
        below = " or ".join(str(path) for path in surface_folders(folder))
        remedy = f"name {below} instead" if below else "run 'make data' or name another folder"
        raise DataError(f"{folder} holds no *{PUSHER_SUFFIX} file; {remedy}")
    pairs, digest = list(listing.pairs.values()), hashlib.sha256()
    pusher_files = [_read_array(pair.pusher, digest) for pair in pairs]
    outcome_files = [_read_array(pair.outcome, digest) for pair in pairs]
    pushers, outcomes = zip(*map(_in_si, pairs, pusher_files, outcome_files), strict=True)
    rows = max(len(array) for array in pushers)
    valid = np.array([[1.0] * len(array) + [0.0] * (rows - len(array)) for array in pushers], dtype=np.float32)
    return Pushes(
        tuple(listing.pairs),
        _padded(pushers, rows),
        _padded(outcomes, rows),
        valid,
        read_source(folder),
        digest.hexdigest(),
    )


def read_object(pair: FilePair) -> tuple[Array, Array]:
    """Return the pushers and outcomes of one object in SI units, float64 [pushes, 3] each.

    Raises:
        DataError: A file is missing or broken. The message names it.
    """
    pushers, outcomes = read_pair(pair)
    return _in_si(pair, pushers.astype(np.float64), outcomes.astype(np.float64))


def write_object(
    folder: Path,
    descriptor: str,
    pushers: Array,
    outcomes: Array,
    variants: Collection[Variant] = (Variant.RAW,),
) -> None:
    """Write the pushes of one object. The raw outcome file comes last: if it exists, the object is complete.

    Raises:
        DataError: The folder cannot be written.
    """
    if Variant.NORMALISED in variants:
        write_pair(folder, descriptor, Variant.NORMALISED, *published_normalisation().normalised(pushers, outcomes))
    if Variant.RAW in variants:
        write_pair(folder, descriptor, Variant.RAW, pushers, outcomes)


def has_object(folder: Path, descriptor: str) -> bool:
    """Return whether both raw files of an object exist."""
    return all((folder / (descriptor + suffix)).is_file() for suffix in (PUSHER_SUFFIX, OUTCOME_SUFFIX))


def export_variants(folder: Path, target: Path, variants: Collection[Variant], quiet: bool = False) -> int:
    """Write every object of a folder into another folder, with the declaration of a simulated folder.

    Returns:
        The number of objects written.

    Raises:
        DataError: A file is broken, or the target holds other data or cannot be written.
    """
    listing = _listing_to_export(folder)
    if target.is_dir() and target.samefile(folder):
        raise DataError(f"{target} is the folder to export; name another one to write to")
    copy_declaration(folder, target)
    for pair in tqdm(
        listing.pairs.values(), desc="writing", unit="object", disable=True if quiet else None, leave=False
    ):
        write_object(target, pair.descriptor, *read_object(pair), variants)
    return len(listing.pairs)


def _listing_to_export(folder: Path) -> FolderListing:
    listing = list_folder(folder)
    if listing.faults:
        raise listing.faults[0]
    if not listing.pairs:
        raise DataError(f"{folder} holds no *{PUSHER_SUFFIX} file; name the folder of one surface")
    return listing


def _read_array(path: Path, digest: "hashlib._Hash") -> Array:
    content = read_content(path, PUSHES)
    digest.update(f"{path.name}\0{len(content)}\0".encode())
    digest.update(content)
    return parse_pushes(path, content).astype(np.float64)


def _in_si(pair: FilePair, pushers: Array, outcomes: Array) -> tuple[Array, Array]:
    check_lengths(pair, pushers, outcomes)
    if pair.variant is Variant.RAW:
        return pushers, outcomes
    return published_normalisation().in_si(pushers, outcomes)


def _padded(arrays: Iterable[npt.NDArray[np.float64]], rows: int) -> FloatArray:
    return np.stack([np.pad(array, ((0, rows - len(array)), (0, 0))) for array in arrays]).astype(np.float32)
