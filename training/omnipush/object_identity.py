"""Object identity: descriptors that denote the same object, turned by whole sides.

The choice of the first side of an object is arbitrary: ``2a3b4a1a`` is the object ``1a2a3b4a``, turned. The benchmark
divides objects into training and test, so membership is decided by identity. The context of a file stays that of its
own descriptor, because its pushes are in the frame of its own first side. Weights turn with their sides: B and C mean a
position within a triangle and keep their letters. A mirrored object is a different object.
"""

from collections.abc import Iterable, Sequence

from service.errors import DataError
from service.pushing.contexts import SIDES, ObjectContext


def canonical_descriptor(descriptor: str) -> str:
    """Return the canonical descriptor of an object: the first of its four turned descriptors in text order.

    Raises:
        InvalidRequestError: The descriptor is not that of an object.
    """
    context = ObjectContext.from_descriptor(descriptor)
    return min(context.turned(turns).descriptor() for turns in range(SIDES))


def quarter_turns(descriptor: str, other: str) -> int | None:
    """Count the turns by +90 degrees that change the first object into the other. None: they are different objects."""
    context = ObjectContext.from_descriptor(descriptor)
    return next((turns for turns in range(SIDES) if context.turned(turns).descriptor() == other), None)


def group_by_object(descriptors: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Group descriptors, in the order given, by the canonical descriptor of their object."""
    groups: dict[str, tuple[str, ...]] = {}
    for descriptor in descriptors:
        canonical = canonical_descriptor(descriptor)
        groups[canonical] = (*groups.get(canonical, ()), descriptor)
    return groups


def find_objects(wanted: Sequence[str], present: Iterable[str]) -> list[str]:
    """Find the descriptor, turned or not, under which each wanted object is present. The order is that of ``wanted``.

    Raises:
        DataError: An object is missing, or present under two descriptors, of which only one can be the published one.
    """
    groups = group_by_object(present)
    found = {descriptor: groups.get(canonical_descriptor(descriptor), ()) for descriptor in wanted}
    missing = [descriptor for descriptor, names in found.items() if not names]
    if missing:
        raise DataError(
            f"{len(missing)} of the {len(wanted)} objects wanted are missing from the data: {shortened(missing)}; "
            "simulate them (make data) or choose another folder"
        )
    for names in found.values():
        if len(names) > 1:
            raise DataError(
                f"{' and '.join(names)} are the same object, turned by whole sides, but a folder must hold a published "
                "object once; keep the files of one of them"
            )
    return [found[descriptor][0] for descriptor in wanted]


def counted(descriptors: Sequence[str]) -> str:
    """Return the number of objects and their first descriptors, for a message of one line."""
    return f"{len(descriptors)} {'object' if len(descriptors) == 1 else 'objects'} ({shortened(descriptors)})"


def shortened(descriptors: Sequence[str], limit: int = 5) -> str:
    """Return the first few of a list of descriptors, for a message of one line."""
    return ", ".join(descriptors[:limit]) + (" ..." if len(descriptors) > limit else "")
