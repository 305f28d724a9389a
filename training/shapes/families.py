"""Families of outlines by name, each of a kind, and the choice of families by names, of which some are held out."""

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from shapely import Polygon

from service.errors import DataError
from training.shapes import blobs, letters, polygons, tools

Drawer = Callable[[np.random.Generator], Polygon]
KINDS: Final[Mapping[str, Mapping[str, Drawer]]] = MappingProxyType(
    {
        "blocks": {
            "box": polygons.box,
            "rounded-box": polygons.rounded_box,
            "bar": polygons.bar,
            "regular-polygon": polygons.regular_polygon,
            "irregular-polygon": polygons.irregular_polygon,
            "ellipse": polygons.disc_or_ellipse,
            "star": polygons.star,
        },
        "letters": {
            "L": letters.letter_l,
            "T": letters.letter_t,
            "U": letters.letter_u,
            "H": letters.letter_h,
            "Z": letters.letter_z,
            "cross": letters.cross,
        },
        "tools": {
            "wrench": tools.wrench,
            "hammer": tools.hammer,
            "screwdriver": tools.screwdriver,
            "bottle": tools.bottle,
            "mug": tools.mug,
            "pan": tools.pan,
            "spoon": tools.spoon,
            "key": tools.key,
        },
        "blobs": {
            "blob": blobs.blob,
            "bean": blobs.bean,
            "union": blobs.union,
        },
    }
)
FAMILIES: Final[Mapping[str, Drawer]] = MappingProxyType(
    {name: drawer for families in KINDS.values() for name, drawer in families.items()}
)


def chosen_families(names: Iterable[str] = (), held_out: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the families among ``names`` (all without any), less the held out ones, in the order of the table.

    A name is that of a family or of a kind, which stands for all of its families.

    Raises:
        DataError: A name is neither, or no family is left.
    """
    chosen, dropped = _families(names) or set(FAMILIES), _families(held_out)
    left = tuple(family for family in FAMILIES if family in chosen - dropped)
    if not left:
        raise DataError("no family of shapes is left; hold out fewer families, or name more")
    return left


def _families(names: Iterable[str]) -> set[str]:
    """Return the families that names of families and kinds stand for."""
    found: set[str] = set()
    for name in names:
        if name not in FAMILIES and name not in KINDS:
            raise DataError(f"{name!r} is no family of shapes; name one of {', '.join((*KINDS, *FAMILIES))}")
        found |= {name} if name in FAMILIES else set(KINDS[name])
    return found
