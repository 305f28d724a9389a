"""A run folder on its way to a machine that does not see this disk, and what came of it on its way home."""

from pathlib import Path

from training.fitting.run_folder import CHECKPOINT_FILE

Parcel = dict[str, bytes]


def pack(folder: Path) -> Parcel:
    """The files of a run folder, however far the run is; nothing where it has not begun."""
    if not folder.is_dir():
        return {}
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.suffix != ".part"}


def changed(before: Parcel, folder: Path) -> Parcel:
    """The files of a folder that are not as they were."""
    return {name: content for name, content in pack(folder).items() if before.get(name) != content}


def unpack(parcel: Parcel, folder: Path) -> None:
    """Put files into a run folder; the checkpoint last, since it says how far the others are."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in sorted(parcel, key=lambda name: name == CHECKPOINT_FILE):
        part = folder / (name + ".part")
        part.write_bytes(parcel[name])
        part.replace(folder / name)
