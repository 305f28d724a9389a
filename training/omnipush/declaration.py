"""``dataset.json``: the declaration of a folder that this project simulated."""

import json
from pathlib import Path
from typing import Any, Final

from service.errors import DataError
from training.omnipush.files import (
    write_whole,
    writing,
)

DATASET_FILE: Final = "dataset.json"
UNKNOWN_SOURCE: Final = "Omnipush-format files of undeclared origin"


def declare_dataset(folder: Path, declaration: dict[str, Any]) -> None:
    """Write down what a folder holds before anything is in it, or check that it is what is already there.

    Raises:
        DataError: the folder holds something else, or cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    path = folder / DATASET_FILE
    text = json.dumps(declaration, indent=2, sort_keys=True) + "\n"
    if path.exists():
        if path.read_bytes() != text.encode():
            raise DataError(f"{path} declares another dataset; give an empty folder, or remove this one")
    elif any(folder.glob("*.npy")):
        raise DataError(f"{folder} already holds pushes that nothing declares as simulated; give an empty folder")
    else:
        write_whole(path, text.encode())


def copy_declaration(folder: Path, target: Path) -> None:
    """Make a target for the pushes of a folder: declared as that folder is, or empty of pushes where nothing is.

    Raises:
        DataError: the target holds something else, or cannot be written.
    """
    path = folder / DATASET_FILE
    if path.is_file():
        read_source(folder)
        declare_dataset(target, json.loads(path.read_text(encoding="utf-8")))
        return
    if target.is_dir() and any(target.glob("*.npy")):
        raise DataError(f"{target} already holds pushes; give an empty folder")
    with writing(target):
        target.mkdir(parents=True, exist_ok=True)


def read_source(folder: Path) -> str:
    """Where the pushes of a folder come from, as it declares; undeclared origin is called that.

    Raises:
        DataError: the declaration does not say.
    """
    path = folder / DATASET_FILE
    if not path.is_file():
        return UNKNOWN_SOURCE
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["source"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataError(
            f"{path} does not say where the pushes come from (key 'source'); restore or remove it"
        ) from error
