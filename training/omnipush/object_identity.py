"""Kinds of object: descriptors that are the same object turned by whole sides.

Which side is called the first is a choice of whoever named a file: ``2a3b4a1a`` is the object ``1a2a3b4a`` turned. The
benchmark divides kinds into training and test, so membership is decided by kind; the context of a file stays its own
descriptor, because its pushes are in the frame of its own first side. Weights turn with their sides: B and C name a
place within a triangle and stay its letters. A mirrored object is another kind.
"""

from collections.abc import Iterable, Sequence

from service.errors import DataError
from service.pushing.contexts import SIDES, ObjectContext


def canonical_descriptor(descriptor: str) -> str:
    """The one name of an object's kind: the first, in the order of text, of its four turned descriptors.

    Raises:
        InvalidRequestError: the descriptor names no object.
    """
    context = ObjectContext.from_descriptor(descriptor)
    return min(context.turned(turns).descriptor() for turns in range(SIDES))


def quarter_turns(descriptor: str, other: str) -> int | None:
    """By how many times +90 degrees the first object must be turned to be the other; None where it cannot."""
    context = ObjectContext.from_descriptor(descriptor)
    return next((turns for turns in range(SIDES) if context.turned(turns).descriptor() == other), None)


def by_kind(descriptors: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """The descriptors of each kind, in the order given, under the kind's canonical name."""
    kinds: dict[str, tuple[str, ...]] = {}
    for descriptor in descriptors:
        kind = canonical_descriptor(descriptor)
        kinds[kind] = (*kinds.get(kind, ()), descriptor)
    return kinds


def find_kinds(wanted: Sequence[str], present: Iterable[str]) -> list[str]:
    """The descriptor under which each wanted object is there, in the order wanted, be it turned or not.

    Raises:
        DataError: an object is missing, or there twice: two files of one kind cannot both be the published object.
    """
    kinds = by_kind(present)
    found = {descriptor: kinds.get(canonical_descriptor(descriptor), ()) for descriptor in wanted}
    missing = [descriptor for descriptor, names in found.items() if not names]
    if missing:
        raise DataError(
            f"{len(missing)} of the {len(wanted)} objects wanted are missing from the data: {shortened(missing)}; "
            "simulate them (make data) or choose another folder"
        )
    for names in found.values():
        if len(names) > 1:
            raise DataError(
                f"{' and '.join(names)} are the same kind of object, turned by whole sides, and a published object is "
                "there once: keep the files of one of them in the folder"
            )
    return [found[descriptor][0] for descriptor in wanted]


def named(descriptors: Sequence[str]) -> str:
    """How many objects, and which, for a message of one line."""
    return f"{len(descriptors)} {'object' if len(descriptors) == 1 else 'objects'} ({shortened(descriptors)})"


def shortened(descriptors: Sequence[str], limit: int = 5) -> str:
    """The first few of a list, for a message of one line."""
    return ", ".join(descriptors[:limit]) + (" ..." if len(descriptors) > limit else "")
