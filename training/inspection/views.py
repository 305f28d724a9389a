"""Checks of the top-down views in a copy of Omnipush: missing, broken and duplicate ones.

A view is ``shape_<descriptor>.npy``, 481 x 481. It shows the object in the frame of the descriptor in its name, so a
view under a turned descriptor does not count as the object's own.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from service.errors import DataError, InvalidRequestError
from service.pushing.contexts import ObjectContext
from training.inspection.findings import DatasetFinding, Severity
from training.omnipush.object_identity import canonical_descriptor, counted
from training.omnipush.views import VIEW_PREFIX, VIEWS_FOLDER, read_view


def find_views(places: Iterable[Path]) -> dict[str, tuple[Path, ...]]:
    """Find the views in the folders ``top-down_view`` of these places, at any depth, by descriptor."""
    roots = {place.resolve() / VIEWS_FOLDER for place in places}
    views: dict[str, tuple[Path, ...]] = {}
    for path in sorted(path for root in roots for path in root.rglob(VIEW_PREFIX + "*.npy")):
        descriptor = path.stem.removeprefix(VIEW_PREFIX)
        views[descriptor] = (*views.get(descriptor, ()), path)
    return views


def odd_views(views: Mapping[str, Sequence[Path]], quiet: bool) -> Iterator[DatasetFinding]:
    """Find views that name no object, occur twice, or are not an image of the published size."""
    for descriptor, paths in tqdm(
        views.items(), desc="reading views", unit="view", disable=True if quiet else None, leave=False
    ):
        try:
            _check_name(descriptor, paths)
            read_view(paths[0])
        except DataError as error:
            yield DatasetFinding(Severity.ERROR, "view-broken", str(paths[0]), str(error))


def missing_views(
    where: str, descriptors: Iterable[str], views: Mapping[str, Sequence[Path]]
) -> Iterator[DatasetFinding]:
    """Find objects without a view under their own descriptor."""
    missing = [descriptor for descriptor in descriptors if descriptor not in views]
    if not missing:
        return
    text = f"no top-down view of {counted(missing)}; a visual model cannot be trained on them"
    viewed = {canonical_descriptor(descriptor) for descriptor in views if _is_object(descriptor)}
    turned = [descriptor for descriptor in missing if canonical_descriptor(descriptor) in viewed]
    if turned:
        text += f"; of {counted(turned)} there is one under a turned descriptor, which shows another frame"
    yield DatasetFinding(Severity.WARNING, "views-missing", where, text)


def _check_name(descriptor: str, paths: Sequence[Path]) -> None:
    if not _is_object(descriptor):
        raise DataError(f"{paths[0]} names no Omnipush object; rename or remove it")
    if len(paths) > 1:
        raise DataError(f"{paths[0]} and {paths[1]} are views of the same object; keep one of them")


def _is_object(descriptor: str) -> bool:
    try:
        ObjectContext.from_descriptor(descriptor)
    except InvalidRequestError:
        return False
    return True
