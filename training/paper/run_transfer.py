"""Run transfer: the files of a run folder as bytes, for workers that do not share this disk."""

from pathlib import Path

from service.storage.disk import replace_whole
from training.fitting.run_folder import CHECKPOINT_FILE

RunFiles = dict[str, bytes]


def pack(folder: Path) -> RunFiles:
    """Read the files of a run folder, in any state of the run. A run that has not begun has none."""
    if not folder.is_dir():
        return {}
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.suffix != ".part"}


def changed(before: RunFiles, folder: Path) -> RunFiles:
    """Read the files of a run folder that differ from those before."""
    return {name: content for name, content in pack(folder).items() if before.get(name) != content}


def unpack(files: RunFiles, folder: Path) -> None:
    """Write files into a run folder, each as a whole, and the checkpoint last: it states how far the others are."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in sorted(files, key=lambda name: name == CHECKPOINT_FILE):
        replace_whole(folder / name, files[name])
