"""Write pushes again in the release's variants: the same pushes, raw, normalised, or both."""

from collections.abc import Collection
from pathlib import Path

from tqdm import tqdm

from service.errors import DataError
from training.omnipush.files import Variant, list_folder
from training.omnipush.pushes import copy_declaration, read_object, write_object


def export_variants(folder: Path, target: Path, variants: Collection[Variant], quiet: bool = False) -> int:
    """Write every object of a folder into another; the declaration of a simulated folder goes with it.

    Returns:
        The number of objects written.

    Raises:
        DataError: a file is broken, or the target holds something else or cannot be written.
    """
    listing = list_folder(folder)
    if listing.faults:
        raise listing.faults[0]
    if not listing.pairs:
        raise DataError(f"{folder} holds no *{Variant.RAW.pusher_suffix} file; name the folder of one surface")
    if target.is_dir() and target.samefile(folder):
        raise DataError(f"{target} is the folder to export; name another one to write to")
    copy_declaration(folder, target)
    for pair in tqdm(
        listing.pairs.values(), desc="writing", unit="object", disable=True if quiet else None, leave=False
    ):
        write_object(target, pair.descriptor, *read_object(pair), variants)
    return len(listing.pairs)
