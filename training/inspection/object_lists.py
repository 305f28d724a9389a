"""Which objects of the published lists a surface holds, matched up to rotation by whole sides."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from training.inspection.findings import Finding, Severity
from training.omnipush.layout import SurfaceKind
from training.omnipush.object_identity import by_kind, canonical_descriptor, named
from training.omnipush.published import different_objects, different_surfaces


@dataclass(frozen=True)
class PublishedList:
    """A published list of objects, by what a folder has of it; names as published."""

    name: str
    present: tuple[str, ...]
    missing: tuple[str, ...]


@dataclass(frozen=True)
class Membership:
    """The published lists of a surface, and what is beside them; names of ``turned`` and ``extra`` are the files'."""

    lists: tuple[PublishedList, ...]
    turned: tuple[str, ...]  # published objects under another turn of their descriptor
    extra: tuple[str, ...]  # objects of no list

    def findings(self, where: str) -> Iterator[Finding]:
        """Published objects that are missing, and objects that no set-up uses."""
        for found in self.lists:
            if found.missing:
                count = len(found.present) + len(found.missing)
                text = (
                    f"missing of the {count} published to {found.name}: {named(found.missing)}; fetch or simulate them"
                )
                yield Finding(Severity.ERROR, "objects-missing", where, text)
        if self.extra:
            text = f"in no published list: {named(self.extra)}; no set-up uses them"
            yield Finding(Severity.WARNING, "objects-extra", where, text)


def membership(surface: SurfaceKind, descriptors: Sequence[str]) -> Membership:
    """Compare the objects of a folder with what was published of its surface."""
    there = by_kind(descriptors)
    published = dict(_published(surface))
    names = {name for objects in published.values() for name in objects}
    kinds = by_kind(names)
    return Membership(
        lists=tuple(
            PublishedList(
                name,
                tuple(thing for thing in objects if canonical_descriptor(thing) in there),
                tuple(thing for thing in objects if canonical_descriptor(thing) not in there),
            )
            for name, objects in published.items()
        ),
        turned=tuple(name for name in descriptors if name not in names and canonical_descriptor(name) in kinds),
        extra=tuple(name for name in descriptors if canonical_descriptor(name) not in kinds),
    )


def _published(surface: SurfaceKind) -> Iterable[tuple[str, tuple[str, ...]]]:
    if surface is SurfaceKind.PLYWOOD:
        yield "test", different_surfaces().test
    else:
        split = different_objects()
        yield "train", split.train
        yield "test", split.test
