"""``dataset.json``: the declaration of a folder that this project simulated."""

import json
from pathlib import Path
from typing import Any, Final

from service.errors import DataError
from service.files import read_file, read_text
from training.omnipush.npy_files import write_whole, writing

DATASET_FILE: Final = "dataset.json"
UNKNOWN_SOURCE: Final = "Omnipush-format files of undeclared origin"


def declare_dataset(folder: Path, declaration: dict[str, Any]) -> None:
    """Write the declaration of an empty folder, or check that a folder already has the same one.

    Raises:
        DataError: The folder holds other data, or cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    path = folder / DATASET_FILE
    text = json.dumps(declaration, indent=2, sort_keys=True) + "\n"
    if path.exists():
        if read_file(path) != text.encode():
            raise DataError(f"{path} declares another dataset; give an empty folder, or remove this one")
    elif any(folder.glob("*.npy")):
        raise DataError(f"{folder} already holds files that are not declared as simulated; give an empty folder")
    else:
        write_whole(path, text.encode())


def copy_declaration(folder: Path, target: Path) -> None:
    """Make a target folder for the pushes of a folder, and copy the declaration if there is one.

    Raises:
        DataError: The target holds other data, or cannot be written.
    """
    path = folder / DATASET_FILE
    if path.is_file():
        read_source(folder)
        declare_dataset(target, json.loads(read_text(path)))
        return
    if target.is_dir() and any(target.glob("*.npy")):
        raise DataError(f"{target} already holds pushes; give an empty folder")
    with writing(target):
        target.mkdir(parents=True, exist_ok=True)


def read_source(folder: Path) -> str:
    """Return the source that a folder of pushes declares, or ``UNKNOWN_SOURCE`` without a declaration.

    Raises:
        DataError: The declaration names no source.
    """
    return read_declared(folder, "source", UNKNOWN_SOURCE)


def read_declared(folder: Path, key: str, default: str) -> str:
    """Return the text under a key of a folder's declaration, or the default without a declaration.

    Raises:
        DataError: The declaration is not JSON, or lacks the key.
    """
    path = folder / DATASET_FILE
    if not path.is_file():
        return default
    try:
        return str(json.loads(read_text(path))[key])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataError(
            f"{path} is not JSON with a key '{key}'; restore or remove it, or name another folder"
        ) from error
