"""Is a copy of Omnipush, or of anything in its format, fit to train on? Reads all of it and tells all that is odd.

Unlike the loader, which stops at the first fault, an inspection goes on: one report names every broken file.
"""

import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from service.errors import DataError
from training.inspection.findings import Finding, ObjectPushes, Severity, odd_normalised, surface_findings
from training.inspection.object_lists import Membership, membership
from training.inspection.statistics import Likeness, likeness, missed
from training.inspection.views import find_views, missing_views, odd_views
from training.omnipush.declaration import UNKNOWN_SOURCE, read_source
from training.omnipush.files import Array, FilePair, FolderListing, Variant, list_folder, read_pair
from training.omnipush.layout import SurfaceKind, surface_folders, surface_kind, view_places
from training.omnipush.object_identity import named
from training.omnipush.published import published_normalisation


@dataclass(frozen=True)
class SurfaceReport:
    """What one folder of pushes holds."""

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
    figures: tuple[Likeness, ...]
    membership: Membership
    views: int  # objects with a top-down view


@dataclass(frozen=True)
class Inspection:
    """The report on a folder."""

    folder: Path
    surfaces: tuple[SurfaceReport, ...]
    findings: tuple[Finding, ...]

    def of(self, severity: Severity) -> list[Finding]:
        """The findings of one severity."""
        return [finding for finding in self.findings if finding.severity is severity]

    @property
    def fit_to_train_on(self) -> bool:
        """Whether nothing was found that makes training wrong."""
        return not self.of(Severity.ERROR)


def inspect(folder: Path, quiet: bool = False) -> Inspection:
    """Read every file of pushes and every top-down view of a copy of Omnipush, or of one surface of it.

    Raises:
        DataError: it is no folder, cannot be listed, or holds no pushes.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder of pushes; run 'make data' or name another (see docs/data.md)")
    surfaces = surface_folders(folder)
    if not surfaces:
        raise DataError(
            f"{folder} holds no *{Variant.RAW.pusher_suffix} file, nor do the folders in it; "
            "run 'make data', or fetch Omnipush as docs/data.md tells"
        )
    views = find_views(view_places(folder, surfaces))
    reports: list[SurfaceReport] = []
    findings: list[Finding] = []
    for surface in surfaces:
        listing = list_folder(surface)
        findings += [_refusal(surface, error) for error in listing.faults]
        objects = list(_readable(surface, listing.pairs.values(), findings, quiet))
        if objects:
            report = _report(surface, listing, objects, set(views), _source(surface, findings))
            reports.append(report)
            findings += _odd_variants(surface, listing, objects)
            findings += surface_findings(str(surface), objects, report.figures)
            findings += report.membership.findings(str(surface))
            findings += missing_views(str(surface), (thing.descriptor for thing in objects), views)
    findings += odd_views(views, quiet)
    return Inspection(folder, tuple(reports), tuple(findings))


def _report(
    folder: Path, listing: FolderListing, objects: Sequence[ObjectPushes], views: set[str], source: str
) -> SurfaceReport:
    pushers = np.concatenate([thing.pushers for thing in objects])
    outcomes = np.concatenate([thing.outcomes for thing in objects])
    names, rows = [thing.descriptor for thing in objects], [len(thing.pushers) for thing in objects]
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
        dtypes=dict(Counter(dtype for thing in objects for dtype in thing.dtypes)),
        missed_share=float(missed(outcomes).mean()),
        figures=likeness(pushers, outcomes, published_normalisation()),
        membership=membership(surface_kind(folder), names),
        views=len(views & set(names)),
    )


def _readable(folder: Path, pairs: Iterable[FilePair], findings: list[Finding], quiet: bool) -> Iterator[ObjectPushes]:
    """Every object that can be read; why the others cannot goes to the findings."""
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


def _source(folder: Path, findings: list[Finding]) -> str:
    try:
        return read_source(folder)
    except DataError as error:
        findings.append(_refusal(folder, error))
        return UNKNOWN_SOURCE


def _odd_variants(folder: Path, listing: FolderListing, objects: Sequence[ObjectPushes]) -> Iterator[Finding]:
    """What is odd about raw and normalised files beside each other; the trainer reads the raw ones where it can."""

    def warning(code: str, text: str) -> Finding:
        return Finding(Severity.WARNING, code, str(folder), text)

    yield from (warning("twin-broken", text) for text in listing.warnings)
    alone = [pair.descriptor for pair in listing.pairs.values() if pair.variant is Variant.NORMALISED]
    if alone:
        yield warning("normalised-only", f"no raw files of {named(alone)}; the normalised ones are read")
    lone = [name for name in listing.pairs if name not in listing.twins and name not in alone]
    if listing.twins and lone:
        yield warning("twin-missing", f"no normalised twin of {named(lone)}; the trainer needs none")
    twins: dict[str, tuple[ObjectPushes, Array]] = {}
    for thing in objects:
        if thing.descriptor in listing.twins:
            try:
                arrays = read_pair(listing.twins[thing.descriptor])
            except DataError as error:
                yield warning("twin-broken", f"{error} (the trainer reads the raw files)")
            else:
                twins[thing.descriptor] = thing, np.column_stack(arrays).astype(np.float64)
    yield from odd_normalised(str(folder), twins)


def _refusal(folder: Path, error: DataError) -> Finding:
    """What the loader refuses, in its own words."""
    return Finding(Severity.ERROR, "refused", str(folder), str(error))
