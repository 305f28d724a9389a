"""Omnipush-format folders to arrays, the published splits and statistics, and a digest of what was read.

A folder holds, for each object, ``<descriptor>..._X_3_not_norm.npy`` (pusher poses) and the same name with ``y`` for
``X`` (object poses after the push), both [pushes, 3] in metres, metres, radians in the object frame. A folder that
this project simulated also holds ``dataset.json``, which says so: everything made from it carries that name.
"""

import hashlib
import io
import json
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from service.contract import FloatArray, ObjectContext
from service.errors import DataError, InvalidRequestError

PUSHER_SUFFIX: Final = "_X_3_not_norm.npy"
OUTCOME_SUFFIX: Final = "_y_3_not_norm.npy"
DATASET_FILE: Final = "dataset.json"
UNKNOWN_SOURCE: Final = "Omnipush-format files of undeclared origin"
_PUSHER_FILE = re.compile(r"(?P<descriptor>[1-4abcBC]{8})(?P<rest>.*)" + re.escape(PUSHER_SUFFIX))


@dataclass(frozen=True)
class Normalisation:
    """Mean and standard deviation of inputs and outputs, float64 [3] each, in SI units (Omnipush data release)."""

    input_mean: npt.NDArray[np.float64]
    input_std: npt.NDArray[np.float64]
    output_mean: npt.NDArray[np.float64]
    output_std: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Split:
    """Which objects a set-up trains on and which it holds out."""

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]


@dataclass(frozen=True)
class Pushes:
    """Pushes of some objects as dense arrays; objects with fewer rows than others are padded, ``valid`` says where."""

    descriptors: tuple[str, ...]
    pushers: FloatArray  # (objects, rows, 3), x_m, y_m, angle_rad
    outcomes: FloatArray  # (objects, rows, 3), x_m, y_m, yaw_rad
    valid: FloatArray  # (objects, rows), 1 for a push, 0 for padding
    source: str
    digest: str  # sha256 of the names and bytes of every file read

    @property
    def indicators(self) -> FloatArray:
        """The indicator context of each object, (objects, 36)."""
        return np.stack([ObjectContext.from_descriptor(name).indicator() for name in self.descriptors])

    @property
    def count(self) -> int:
        """Number of pushes, padding left out."""
        return int(self.valid.sum())

    def select(self, descriptors: Sequence[str]) -> "Pushes":
        """The same pushes of these objects only, in this order; source and digest stay those of the folder read.

        Raises:
            DataError: an object is not there.
        """
        place = {descriptor: row for row, descriptor in enumerate(self.descriptors)}
        missing = [descriptor for descriptor in descriptors if descriptor not in place]
        if missing:
            shown = ", ".join(missing[:5]) + (" ..." if len(missing) > 5 else "")
            raise DataError(
                f"{len(missing)} of the {len(descriptors)} objects wanted are missing from the data: {shown}; "
                "simulate them (make data) or choose another folder"
            )
        rows = [place[descriptor] for descriptor in descriptors]
        return Pushes(
            tuple(descriptors), self.pushers[rows], self.outcomes[rows], self.valid[rows], self.source, self.digest
        )


@cache
def _facts() -> dict[str, Any]:
    """The published facts of Omnipush that ship with the trainer; the file names its sources."""
    text = resources.files("training").joinpath("omnipush_facts.json").read_text(encoding="utf-8")
    facts: dict[str, Any] = json.loads(text)
    return facts


def published_normalisation() -> Normalisation:
    """The published statistics of Omnipush, used for every dataset."""
    facts = _facts()["normalisation"]
    names = ("input_mean", "input_std", "output_mean", "output_std")
    return Normalisation(*(np.array(facts[name], dtype=np.float64) for name in names))


def different_objects() -> Split:
    """The published division of the 250 ABS objects: 200 to train on, 50 held out."""
    facts = _facts()["different_objects"]
    return Split("different-objects", tuple(facts["train"]), tuple(facts["test"]))


def omnipush_descriptors() -> tuple[str, ...]:
    """All 250 objects of the benchmark, sorted."""
    split = different_objects()
    return tuple(sorted(split.train + split.test))


def read_folder(folder: Path) -> Pushes:
    """Every object of an Omnipush-format folder.

    Raises:
        DataError: names the file at fault, what was expected and what to do.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder of pushes; run 'make data' or name another with --data")
    pairs = _pairs(folder)
    digest = hashlib.sha256()
    pushers = [_read_array(pusher_file, digest) for pusher_file, _ in pairs.values()]
    outcomes = [_read_array(outcome_file, digest) for _, outcome_file in pairs.values()]
    for (pusher_file, outcome_file), inputs, outputs in zip(pairs.values(), pushers, outcomes, strict=True):
        if len(inputs) != len(outputs):
            raise DataError(
                f"{outcome_file} has {len(outputs)} rows and {pusher_file.name} has {len(inputs)}; "
                "both must describe the same pushes: fetch or simulate this object again"
            )
    rows = max(len(array) for array in pushers)
    valid = np.array([[1.0] * len(array) + [0.0] * (rows - len(array)) for array in pushers], dtype=np.float32)
    return Pushes(
        tuple(pairs), _padded(pushers, rows), _padded(outcomes, rows), valid, _source(folder), digest.hexdigest()
    )


def write_object(
    folder: Path, descriptor: str, pushers: npt.NDArray[np.float64], outcomes: npt.NDArray[np.float64]
) -> None:
    """Write one object's pushes; the outcome file comes last, so a pair is whole or not there."""
    _write_whole(folder / (descriptor + PUSHER_SUFFIX), _npy_bytes(pushers))
    _write_whole(folder / (descriptor + OUTCOME_SUFFIX), _npy_bytes(outcomes))


def write_array(path: Path, array: npt.NDArray[Any]) -> None:
    """Write one array as a ``.npy`` file that is whole or not there."""
    _write_whole(path, _npy_bytes(array))


def has_object(folder: Path, descriptor: str) -> bool:
    """Whether both files of an object are there."""
    return all((folder / (descriptor + suffix)).is_file() for suffix in (PUSHER_SUFFIX, OUTCOME_SUFFIX))


def declare_dataset(folder: Path, declaration: dict[str, Any]) -> None:
    """Write down what a folder holds before anything is in it, or check that it is what is already there.

    Raises:
        DataError: the folder holds something else.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / DATASET_FILE
    text = json.dumps(declaration, indent=2, sort_keys=True) + "\n"
    if path.exists():
        if path.read_bytes() != text.encode():
            raise DataError(f"{path} declares another dataset; give an empty folder, or remove this one")
    elif any(folder.glob("*.npy")):
        raise DataError(f"{folder} already holds pushes that nothing declares as simulated; give an empty folder")
    else:
        _write_whole(path, text.encode())


def _pairs(folder: Path) -> dict[str, tuple[Path, Path]]:
    """The pusher and outcome file of each object, sorted by descriptor."""
    pairs: dict[str, tuple[Path, Path]] = {}
    for path in sorted(folder.glob("*" + PUSHER_SUFFIX)):
        match = _PUSHER_FILE.fullmatch(path.name)
        if match is None:
            raise DataError(
                f"{path} does not begin with an 8-character descriptor such as 1a2b3c4a; rename or remove it"
            )
        descriptor = match["descriptor"]
        try:
            ObjectContext.from_descriptor(descriptor)
        except InvalidRequestError as error:
            raise DataError(f"{path} names no Omnipush object ({error}); rename or remove it") from error
        if descriptor in pairs:
            raise DataError(f"{path} and {pairs[descriptor][0].name} are the same object; keep one of them")
        outcome = path.with_name(path.name.removesuffix(PUSHER_SUFFIX) + OUTCOME_SUFFIX)
        if not outcome.is_file():
            raise DataError(f"{outcome} is missing beside {path.name}; fetch or simulate this object again")
        pairs[descriptor] = (path, outcome)
    if not pairs:
        raise DataError(f"{folder} holds no *{PUSHER_SUFFIX} file; run 'make data' or name another folder with --data")
    return pairs


def _read_array(path: Path, digest: "hashlib._Hash") -> npt.NDArray[np.float64]:
    content = path.read_bytes()
    digest.update(f"{path.name}\0{len(content)}\0".encode())
    digest.update(content)
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy parses the header with whatever it finds: no list of errors is complete
        raise DataError(f"{path} is not a whole .npy file of numbers; fetch or simulate this object again") from error
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        shape = getattr(array, "shape", "no array")
        raise DataError(f"{path} has shape {shape}; expected [pushes, 3], one row per push: x_m, y_m, angle_rad")
    if array.dtype.kind != "f":
        raise DataError(f"{path} holds {array.dtype}; expected float32 or float64")
    with np.errstate(over="ignore"):
        finite = np.isfinite(array.astype(np.float32))  # as it will be used
    if not finite.all():
        row = int(np.argwhere(~finite)[0, 0])
        raise DataError(f"{path} row {row} is not finite; remove that push from both files of the object")
    return array.astype(np.float64)


def _padded(arrays: Iterable[npt.NDArray[np.float64]], rows: int) -> FloatArray:
    return np.stack([np.pad(array, ((0, rows - len(array)), (0, 0))) for array in arrays]).astype(np.float32)


def _source(folder: Path) -> str:
    path = folder / DATASET_FILE
    if not path.is_file():
        return UNKNOWN_SOURCE
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["source"])
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path} does not say where the pushes come from (key 'source'); restore or remove it"
        ) from error


def _npy_bytes(array: npt.NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _write_whole(path: Path, content: bytes) -> None:
    """Write beside the target, sync, rename: a reader sees the whole file or none, and so does another writer."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
