"""Inspection of a folder of pushes: is it complete, plausible, and fit to train on?

The loader stops at the first fault. An inspection reads on, so that one report names every broken file.
"""

import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from service.errors import DataError
from training.inspection.findings import (
    ENOUGH_PUSHES,
    DatasetFinding,
    Judged,
    ObjectPushes,
    Severity,
    odd_normalised,
    surface_findings,
)
from training.inspection.object_lists import Membership, membership
from training.inspection.statistics import (
    MotionQuantiles,
    QuantityStatistics,
    compare_statistics,
    missed,
    motion_quantiles,
)
from training.inspection.views import find_views, missing_views, odd_views
from training.omnipush.declaration import UNKNOWN_SOURCE, read_source
from training.omnipush.files import Array, FilePair, FolderListing, Variant, list_folder, read_pair
from training.omnipush.layout import SurfaceKind, surface_folders, surface_kind, view_places
from training.omnipush.object_identity import counted
from training.omnipush.published import published_normalisation, weight_count


@dataclass(frozen=True)
class SurfaceReport:
    """Report on one folder of pushes."""

    surface: SurfaceKind
    folder: Path
    source: str
    objects: int
    pushes: int
    rows: tuple[int, float, int]  # per object: fewest, median, most
    raw_pairs: int
    normalised_pairs: int
    dtypes: dict[str, int]  # files of each precision
    missed_share: float
    figures: tuple[QuantityStatistics, ...]
    motion: MotionQuantiles | None  # of objects without weights on ABS, as recorded
    membership: Membership
    views: int  # objects with a top-down view


@dataclass(frozen=True)
class Inspection(Judged):
    """Inspection of a folder: a report per surface, and the findings."""

    folder: Path
    surfaces: tuple[SurfaceReport, ...]
    findings: tuple[DatasetFinding, ...]


def inspect(folder: Path, quiet: bool = False) -> Inspection:
    """Inspect every file of pushes and every top-down view of a copy of Omnipush, or of one surface of it.

    Raises:
        DataError: The folder does not exist, cannot be listed, or holds no pushes.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder of pushes; run 'make data' or name another (see docs/data.md)")
    surfaces = surface_folders(folder)
    if not surfaces:
        raise DataError(
            f"{folder} holds no *{Variant.RAW.pusher_suffix} file, nor do the folders in it; "
            "run 'make data', or fetch Omnipush as docs/data.md describes"
        )
    views = find_views(view_places(folder, surfaces))
    reports: list[SurfaceReport] = []
    findings: list[DatasetFinding] = []
    for surface in surfaces:
        listing = list_folder(surface)
        findings += [_refusal(surface, error) for error in listing.faults]
        objects = list(_readable(surface, listing.pairs.values(), findings, quiet))
        if objects:
            report = _report(surface, listing, objects, set(views), _source(surface, findings))
            reports.append(report)
            findings += _odd_variants(surface, listing, objects)
            findings += surface_findings(str(surface), objects, report.figures, report.motion, report.surface)
            findings += report.membership.findings(str(surface))
            findings += missing_views(str(surface), (item.descriptor for item in objects), views)
    findings += odd_views(views, quiet)
    return Inspection(folder, tuple(reports), tuple(findings))


def _report(
    folder: Path, listing: FolderListing, objects: Sequence[ObjectPushes], views: set[str], source: str
) -> SurfaceReport:
    pushers = np.concatenate([item.pushers for item in objects])
    outcomes = np.concatenate([item.outcomes for item in objects])
    names, rows = [item.descriptor for item in objects], [len(item.pushers) for item in objects]
    normalised_only = sum(pair.variant is Variant.NORMALISED for pair in listing.pairs.values())
    return SurfaceReport(
        surface=surface_kind(folder),
        folder=folder,
        source=source,
        objects=len(objects),
        pushes=len(pushers),
        rows=(min(rows), statistics.median(rows), max(rows)),
        raw_pairs=len(listing.pairs) - normalised_only,
        normalised_pairs=len(listing.twins) + normalised_only,
        dtypes=dict(Counter(dtype for item in objects for dtype in item.dtypes)),
        missed_share=float(missed(outcomes).mean()),
        figures=compare_statistics(pushers, outcomes, published_normalisation()),
        motion=_motion(surface_kind(folder), objects),
        membership=membership(surface_kind(folder), names),
        views=len(views & set(names)),
    )


def _motion(kind: SurfaceKind, objects: Sequence[ObjectPushes]) -> MotionQuantiles | None:
    """Return quantiles of the pushes of the kind recorded, of objects without weights on ABS, if there are enough."""
    bare = [item.outcomes for item in objects if kind is SurfaceKind.ABS and weight_count(item.descriptor) == 0]
    enough = sum(len(outcomes) for outcomes in bare) >= ENOUGH_PUSHES
    return motion_quantiles(np.concatenate(bare)) if enough else None


def _readable(
    folder: Path, pairs: Iterable[FilePair], findings: list[DatasetFinding], quiet: bool
) -> Iterator[ObjectPushes]:
    """Read every object that can be read, and append the errors of the others to the findings."""
    for pair in tqdm(list(pairs), desc="reading pushes", unit="object", disable=True if quiet else None, leave=False):
        try:
            pushers, outcomes = read_pair(pair)
        except DataError as error:
            findings.append(_refusal(folder, error))
            continue
        values = pushers.astype(np.float64), outcomes.astype(np.float64)
        if pair.variant is Variant.NORMALISED:
            values = published_normalisation().in_si(*values)
        yield ObjectPushes(pair.descriptor, *values, dtypes=(str(pushers.dtype), str(outcomes.dtype)))


def _source(folder: Path, findings: list[DatasetFinding]) -> str:
    try:
        return read_source(folder)
    except DataError as error:
        findings.append(_refusal(folder, error))
        return UNKNOWN_SOURCE


def _odd_variants(folder: Path, listing: FolderListing, objects: Sequence[ObjectPushes]) -> Iterator[DatasetFinding]:
    """Find faults of raw and normalised files beside each other. The trainer prefers the raw ones."""

    def warning(code: str, text: str) -> DatasetFinding:
        return DatasetFinding(Severity.WARNING, code, str(folder), text)

    yield from (warning("twin-broken", text) for text in listing.warnings)
    alone = [pair.descriptor for pair in listing.pairs.values() if pair.variant is Variant.NORMALISED]
    if alone:
        yield warning("normalised-only", f"no raw files of {counted(alone)}; the normalised ones are read")
    lone = [name for name in listing.pairs if name not in listing.twins and name not in alone]
    if listing.twins and lone:
        yield warning("twin-missing", f"no normalised twin of {counted(lone)}; the trainer needs none")
    twins: dict[str, tuple[ObjectPushes, Array]] = {}
    for item in objects:
        if item.descriptor in listing.twins:
            try:
                arrays = read_pair(listing.twins[item.descriptor])
            except DataError as error:
                yield warning("twin-broken", f"{error} (the trainer reads the raw files)")
            else:
                twins[item.descriptor] = item, np.column_stack(arrays).astype(np.float64)
    yield from odd_normalised(str(folder), twins)


def _refusal(folder: Path, error: DataError) -> DatasetFinding:
    """Return a finding with the message of the loader's error."""
    return DatasetFinding(Severity.ERROR, "refused", str(folder), str(error))
