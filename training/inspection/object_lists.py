"""Published lists of objects, compared with the objects of a surface up to rotation by whole sides."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from training.inspection.findings import DatasetFinding, Severity
from training.omnipush.layout import SurfaceKind
from training.omnipush.object_identity import canonical_descriptor, counted, group_by_object
from training.omnipush.published import different_objects, different_surfaces


@dataclass(frozen=True)
class PublishedList:
    """Published list of objects, divided into those that a folder has and those that it lacks."""

    name: str
    present: tuple[str, ...]
    missing: tuple[str, ...]


@dataclass(frozen=True)
class Membership:
    """Published lists of a surface, and the descriptors of files that are turned or in no list."""

    lists: tuple[PublishedList, ...]
    turned: tuple[str, ...]  # published objects under a turned descriptor
    extra: tuple[str, ...]  # objects of no list

    def findings(self, where: str) -> Iterator[DatasetFinding]:
        """Find published objects that are missing, and objects that no set-up uses."""
        for found in self.lists:
            if found.missing:
                count = len(found.present) + len(found.missing)
                text = (
                    f"missing of the {count} published to {found.name}: {counted(found.missing)}; "
                    "fetch or simulate them"
                )
                yield DatasetFinding(Severity.ERROR, "objects-missing", where, text)
        if self.extra:
            text = f"in no published list: {counted(self.extra)}; no set-up uses them"
            yield DatasetFinding(Severity.WARNING, "objects-extra", where, text)


def membership(surface: SurfaceKind, descriptors: Sequence[str]) -> Membership:
    """Compare the objects of a folder with the published lists of its surface."""
    present = group_by_object(descriptors)
    published = dict(_published(surface))
    names = {name for objects in published.values() for name in objects}
    known = group_by_object(names)
    return Membership(
        lists=tuple(
            PublishedList(
                name,
                tuple(item for item in objects if canonical_descriptor(item) in present),
                tuple(item for item in objects if canonical_descriptor(item) not in present),
            )
            for name, objects in published.items()
        ),
        turned=tuple(name for name in descriptors if name not in names and canonical_descriptor(name) in known),
        extra=tuple(name for name in descriptors if canonical_descriptor(name) not in known),
    )


def _published(surface: SurfaceKind) -> Iterable[tuple[str, tuple[str, ...]]]:
    if surface is SurfaceKind.PLYWOOD:
        yield "test", different_surfaces().test
    else:
        split = different_objects()
        yield "train", split.train
        yield "test", split.test
