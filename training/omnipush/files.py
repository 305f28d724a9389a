"""Files of pushes in Omnipush's format: which files belong to which object, and the arrays in them.

The release has the pushes of every object in two variants: raw (``1a2b3c4a_X_3_not_norm.npy``: metres, metres, radians)
and normalised (``1a2b3c4a_X_3_norm.npy``: minus the published mean, divided by the published standard deviation). X
holds the pusher's pose before a push, y the object's pose after it.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from service.errors import DataError, InvalidRequestError
from service.pushing.contexts import ObjectContext
from training.omnipush.npy_files import NpyKind, parse_npy, read_content, write_npy

Array = npt.NDArray[np.float64]
FileArray = npt.NDArray[np.floating[Any]]  # in the precision of a file

PUSHES: Final = NpyKind(64 * 2**20, "250 pushes need 6,128", "fetch or simulate this object again")
_FILE = re.compile(r"(?P<stem>.*)_(?P<axis>[Xy])_3_(?P<variant>not_norm|norm)\.npy")
_DESCRIPTOR = re.compile(r"(?P<descriptor>[1-4abcBC]{8}).*")


class Variant(Enum):
    """Form in which the release holds pushes: raw or normalised."""

    RAW = "not_norm"
    NORMALISED = "norm"

    @property
    def pusher_suffix(self) -> str:
        """Suffix of the name of a pusher file."""
        return f"_X_3_{self.value}.npy"

    @property
    def outcome_suffix(self) -> str:
        """Suffix of the name of an outcome file."""
        return f"_y_3_{self.value}.npy"


@dataclass(frozen=True)
class FilePair:
    """Pusher file and outcome file of one object in one variant. Row i of both describes the same push."""

    descriptor: str
    variant: Variant
    pusher: Path
    outcome: Path


@dataclass(frozen=True)
class FolderListing:
    """Files of a folder, matched to objects by name."""

    pairs: dict[str, FilePair]  # the pair to read of each object, raw if it exists, sorted by descriptor
    twins: dict[str, FilePair]  # normalised pairs of objects that also have a raw one
    faults: tuple[DataError, ...]
    warnings: tuple[str, ...]  # a reader may ignore these


def list_folder(folder: Path) -> FolderListing:
    """Match the files of a folder to objects, by name alone.

    Raises:
        DataError: The folder cannot be listed.
    """
    found: dict[tuple[str, Variant], dict[str, Path]] = {}
    faults: list[DataError] = []
    for path in _npy_files(folder):
        match = _FILE.fullmatch(path.name)
        if match is None:
            continue
        try:
            descriptor = _descriptor(path, match["stem"])
            files = found.setdefault((descriptor, Variant(match["variant"])), {})
            if match["axis"] in files:
                other = files[match["axis"]].name
                raise DataError(f"{path} and {other} are the same object; keep one of them")
            files[match["axis"]] = path
        except DataError as error:
            faults.append(error)
    raw, raw_faults = _complete_pairs(found, Variant.RAW)
    normalised, normalised_faults = _complete_pairs(found, Variant.NORMALISED)
    raw_names = {descriptor for descriptor, variant in found if variant is Variant.RAW}
    faults += raw_faults.values()
    faults += [fault for descriptor, fault in normalised_faults.items() if descriptor not in raw_names]
    return FolderListing(
        pairs=dict(sorted((raw | {name: pair for name, pair in normalised.items() if name not in raw_names}).items())),
        twins={name: pair for name, pair in normalised.items() if name in raw},
        faults=tuple(faults),
        warnings=tuple(str(fault) for name, fault in normalised_faults.items() if name in raw_names),
    )


def parse_pushes(path: Path, content: bytes) -> FileArray:
    """Return the poses in the content of a file of pushes, [pushes, 3], in the precision of the file.

    Raises:
        DataError: The content is not a complete .npy file of finite floating-point numbers of that shape.
    """
    array = parse_npy(path, content, PUSHES)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise DataError(
            f"{path} has shape {array.shape}; expected [pushes, 3], one row per push: x_m, y_m, angle_rad; "
            f"{PUSHES.remedy}"
        )
    if array.dtype.kind != "f":
        raise DataError(f"{path} holds {array.dtype}; expected float32 or float64; {PUSHES.remedy}")
    with np.errstate(over="ignore"):
        finite = np.isfinite(array.astype(np.float32))  # the precision of training
    if not finite.all():
        row = int(np.argwhere(~finite)[0, 0])
        raise DataError(f"{path} row {row} is not finite; remove that push from both files of the object")
    return array


def read_pair(pair: FilePair) -> tuple[FileArray, FileArray]:
    """Return the pushers and outcomes in the files of an object, [pushes, 3] each, in the units of the variant.

    Raises:
        DataError: A file is missing or broken, or the files differ in length. The message names the file.
    """
    pushers, outcomes = (parse_pushes(path, read_content(path, PUSHES)) for path in (pair.pusher, pair.outcome))
    check_lengths(pair, pushers, outcomes)
    return pushers, outcomes


def check_lengths(pair: FilePair, pushers: npt.NDArray[Any], outcomes: npt.NDArray[Any]) -> None:
    """Check that both files of a pair hold equally many pushes.

    Raises:
        DataError: One file has more rows than the other.
    """
    if len(pushers) != len(outcomes):
        raise DataError(
            f"{pair.outcome} has {len(outcomes)} rows and {pair.pusher.name} has {len(pushers)}; "
            f"both must describe the same pushes; {PUSHES.remedy}"
        )


def holds_pushes(folder: Path) -> bool:
    """Return whether a folder has a file with the name of a file of pushes."""
    return any(_FILE.fullmatch(path.name) for path in _npy_files(folder))


def write_pair(folder: Path, descriptor: str, variant: Variant, pushers: Array, outcomes: Array) -> None:
    """Write both files of an object. The outcome file comes last: if it exists, the pair is complete.

    Raises:
        DataError: The folder cannot be written.
    """
    for suffix, array in ((variant.pusher_suffix, pushers), (variant.outcome_suffix, outcomes)):
        write_npy(folder / (descriptor + suffix), array)


def _npy_files(folder: Path) -> list[Path]:
    try:
        return sorted(
            path
            for path in folder.iterdir()
            if path.suffix == ".npy" and not path.name.startswith(".") and path.is_file()
        )
    except OSError as error:
        raise DataError(
            f"{folder} cannot be listed ({error.strerror}); check its permissions, or name another folder"
        ) from error


def _descriptor(path: Path, stem: str) -> str:
    match = _DESCRIPTOR.fullmatch(stem)
    if match is None:
        raise DataError(f"{path} does not begin with an 8-character descriptor such as 1a2b3c4a; rename or remove it")
    try:
        return ObjectContext.from_descriptor(match["descriptor"]).descriptor()
    except InvalidRequestError as error:
        raise DataError(f"{path} names no Omnipush object ({error}); rename or remove it") from error


def _complete_pairs(
    found: dict[tuple[str, Variant], dict[str, Path]], wanted: Variant
) -> tuple[dict[str, FilePair], dict[str, DataError]]:
    """Return the complete pairs of a variant, and a fault for each object with only one of its two files."""
    pairs: dict[str, FilePair] = {}
    faults: dict[str, DataError] = {}
    for (descriptor, variant), files in found.items():
        if variant is not wanted:
            continue
        fault = _missing_file(files.values(), variant)
        if fault is None:
            pairs[descriptor] = FilePair(descriptor, variant, files["X"], files["y"])
        else:
            faults[descriptor] = fault
    return pairs, faults


def _missing_file(files: Iterable[Path], variant: Variant) -> DataError | None:
    """Return the fault of a pair that lacks a file, or whose files have different stems."""
    missing = [twin for path in files if not (twin := _other_file(path, variant)).is_file()]
    if not missing:
        return None
    beside = _other_file(missing[0], variant).name
    return DataError(f"{missing[0]} is missing beside {beside}; {PUSHES.remedy}")


def _other_file(path: Path, variant: Variant) -> Path:
    suffix, other = variant.pusher_suffix, variant.outcome_suffix
    if path.name.endswith(other):
        suffix, other = other, suffix
    return path.with_name(path.name.removesuffix(suffix) + other)
