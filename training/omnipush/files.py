"""Omnipush's files on disk: which files of a folder belong to which object, and their numbers.

The release has every object's pushes in two variants: raw (``1a2b3c4a_X_3_not_norm.npy``: metres, metres, radians) and
normalised (``1a2b3c4a_X_3_norm.npy``: less the published mean, divided by the published standard deviation). X is the
pusher's pose before a push, y the object's after it. Nothing read from disk is trusted: sizes are bounded first, no
pickle is ever loaded, and a file that is not what it should be is named.
"""

import io
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from service.errors import DataError, InvalidRequestError
from service.pushing.contexts import ObjectContext

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.floating[Any]]  # in the precision of a file

MAX_FILE_BYTES: Final = 64 * 2**20  # 250 pushes are 6 kB
_FILE = re.compile(r"(?P<stem>.*)_(?P<axis>[Xy])_3_(?P<variant>not_norm|norm)\.npy")
_DESCRIPTOR = re.compile(r"(?P<descriptor>[1-4abcBC]{8}).*")


class Variant(Enum):
    """The two forms in which the release holds the same pushes."""

    RAW = "not_norm"
    NORMALISED = "norm"

    @property
    def pusher_suffix(self) -> str:
        """How the name of a pusher file ends."""
        return f"_X_3_{self.value}.npy"

    @property
    def outcome_suffix(self) -> str:
        """How the name of an outcome file ends."""
        return f"_y_3_{self.value}.npy"


@dataclass(frozen=True)
class FilePair:
    """The two files of one object in one variant; both describe the same pushes, row by row."""

    descriptor: str
    variant: Variant
    pusher: Path
    outcome: Path


@dataclass(frozen=True)
class FolderListing:
    """What the names in a folder say: the pair to read of each object, the normalised twins beside it, the faults."""

    pairs: dict[str, FilePair]  # raw where there is one, sorted by descriptor
    twins: dict[str, FilePair]  # normalised pairs of objects that also have a raw one
    faults: tuple[DataError, ...]
    warnings: tuple[str, ...]  # what a reader may ignore


def list_folder(folder: Path) -> FolderListing:
    """Match the files of a folder to objects, by name alone.

    Raises:
        DataError: the folder cannot be listed.
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
    raw, raw_faults = _whole_pairs(found, Variant.RAW)
    normalised, normalised_faults = _whole_pairs(found, Variant.NORMALISED)
    raw_names = {descriptor for descriptor, variant in found if variant is Variant.RAW}
    faults += raw_faults.values()
    faults += [fault for descriptor, fault in normalised_faults.items() if descriptor not in raw_names]
    return FolderListing(
        pairs=dict(sorted((raw | {name: pair for name, pair in normalised.items() if name not in raw_names}).items())),
        twins={name: pair for name, pair in normalised.items() if name in raw},
        faults=tuple(faults),
        warnings=tuple(str(fault) for name, fault in normalised_faults.items() if name in raw_names),
    )


def read_content(path: Path) -> bytes:
    """The bytes of a file of pushes.

    Raises:
        DataError: it cannot be read, or is far larger than pushes are.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > MAX_FILE_BYTES:
                raise DataError(
                    f"{path} has {size} bytes; accepted are up to {MAX_FILE_BYTES}, and 250 pushes need 6,128: "
                    "fetch or simulate this object again"
                )
            return file.read(MAX_FILE_BYTES)
    except OSError as error:
        raise DataError(
            f"{path} cannot be read ({error.strerror}); mend its permissions or fetch this object again"
        ) from error


def parse_array(path: Path, content: bytes) -> Numbers:
    """The numbers of a file of pushes in the precision of the file, [pushes, 3].

    Raises:
        DataError: it is no whole .npy file of finite numbers of that shape; pickles are never loaded.
    """
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy parses the header with whatever it finds: no list of errors is complete
        raise DataError(f"{path} is not a whole .npy file of numbers; fetch or simulate this object again") from error
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        shape = getattr(array, "shape", "no array")
        raise DataError(
            f"{path} has shape {shape}; expected [pushes, 3], one row per push: x_m, y_m, angle_rad; "
            "fetch or simulate this object again"
        )
    if array.dtype.kind != "f":
        raise DataError(f"{path} holds {array.dtype}; expected float32 or float64: fetch or simulate this object again")
    with np.errstate(over="ignore"):
        finite = np.isfinite(array.astype(np.float32))  # as it will be used
    if not finite.all():
        row = int(np.argwhere(~finite)[0, 0])
        raise DataError(f"{path} row {row} is not finite; remove that push from both files of the object")
    return array


def read_pair(pair: FilePair) -> tuple[Numbers, Numbers]:
    """Pushers and outcomes of an object as its files have them, [pushes, 3] each: units of the variant.

    Raises:
        DataError: names the file at fault, what was expected and what to do.
    """
    pushers, outcomes = (parse_array(path, read_content(path)) for path in (pair.pusher, pair.outcome))
    check_lengths(pair, pushers, outcomes)
    return pushers, outcomes


def check_lengths(pair: FilePair, pushers: npt.NDArray[Any], outcomes: npt.NDArray[Any]) -> None:
    """Both files of a pair must describe the same pushes.

    Raises:
        DataError: one has more rows than the other.
    """
    if len(pushers) != len(outcomes):
        raise DataError(
            f"{pair.outcome} has {len(outcomes)} rows and {pair.pusher.name} has {len(pushers)}; "
            "both must describe the same pushes: fetch or simulate this object again"
        )


def holds_pushes(folder: Path) -> bool:
    """Whether a folder has any file that is named as pushes are."""
    return any(_FILE.fullmatch(path.name) for path in _npy_files(folder))


def write_pair(folder: Path, descriptor: str, variant: Variant, pushers: Array, outcomes: Array) -> None:
    """Write both files of an object, the outcomes last: a pair is whole or not there.

    Raises:
        DataError: the folder cannot be written.
    """
    for suffix, array in ((variant.pusher_suffix, pushers), (variant.outcome_suffix, outcomes)):
        write_array(folder / (descriptor + suffix), array)


def write_array(path: Path, array: npt.NDArray[Any]) -> None:
    """Write one array as a ``.npy`` file that is whole or not there.

    Raises:
        DataError: the folder cannot be written.
    """
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    write_whole(path, buffer.getvalue())


def write_whole(path: Path, content: bytes) -> None:
    """Write beside the target, sync, rename: a reader sees the whole file or none, and so does another writer.

    Raises:
        DataError: the folder cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with writing(path):
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """What the system refuses inside is told in one line that names the path.

    Raises:
        DataError: the system refused.
    """
    try:
        yield
    except OSError as error:
        raise DataError(f"{path} cannot be written ({error.strerror}); mend that or name another folder") from error


def _npy_files(folder: Path) -> list[Path]:
    try:
        return sorted(
            path
            for path in folder.iterdir()
            if path.suffix == ".npy" and not path.name.startswith(".") and path.is_file()
        )
    except OSError as error:
        raise DataError(
            f"{folder} cannot be listed ({error.strerror}); mend its permissions or name another folder"
        ) from error


def _descriptor(path: Path, stem: str) -> str:
    match = _DESCRIPTOR.fullmatch(stem)
    if match is None:
        raise DataError(f"{path} does not begin with an 8-character descriptor such as 1a2b3c4a; rename or remove it")
    try:
        return ObjectContext.from_descriptor(match["descriptor"]).descriptor()
    except InvalidRequestError as error:
        raise DataError(f"{path} names no Omnipush object ({error}); rename or remove it") from error


def _whole_pairs(
    found: dict[tuple[str, Variant], dict[str, Path]], wanted: Variant
) -> tuple[dict[str, FilePair], dict[str, DataError]]:
    """The pairs of a variant, and what is wrong with the objects that have half of one."""
    pairs: dict[str, FilePair] = {}
    faults: dict[str, DataError] = {}
    for (descriptor, variant), files in found.items():
        if variant is not wanted:
            continue
        half = _missing_half(files.values(), variant)
        if half is None:
            pairs[descriptor] = FilePair(descriptor, variant, files["X"], files["y"])
        else:
            faults[descriptor] = half
    return pairs, faults


def _missing_half(files: Iterable[Path], variant: Variant) -> DataError | None:
    """The fault of a pair whose halves have different stems, or of which one is missing."""
    missing = [twin for path in files if not (twin := _other_half(path, variant)).is_file()]
    if not missing:
        return None
    beside = _other_half(missing[0], variant).name
    return DataError(f"{missing[0]} is missing beside {beside}; fetch or simulate this object again")


def _other_half(path: Path, variant: Variant) -> Path:
    suffix, other = variant.pusher_suffix, variant.outcome_suffix
    if path.name.endswith(other):
        suffix, other = other, suffix
    return path.with_name(path.name.removesuffix(suffix) + other)
