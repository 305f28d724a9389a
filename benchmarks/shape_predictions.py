"""Predictions of models of any shape for a table of pushes, through the client in this process.

Objects are sent by their outlines, in the frame of the table, and pushes with their lengths. Two kinds of knowledge are
asked: all that the table has of an object's body, or its outline alone.
"""

from collections.abc import Iterator
from enum import StrEnum
from typing import Final

import numpy as np
from tqdm import tqdm

from service.client import Client
from service.pushing.poses import DoubleArray
from service.schemas.contexts import ContextBody
from training.tables.push_table import IndexArray, PushTable, TableObject

MOST_PUSHES: Final = 10_000  # of a request
MOST_SHAPES: Final = 1000  # different objects of a request
MOST_LISTS: Final = 50_000  # corners and pushes of a request: a body of JSON may have 60,000 lists


class Knowledge(StrEnum):
    """Knowledge of an object that a model is asked with."""

    BODY = "outline; centre of mass, friction and tip where the table has them"
    OUTLINE = "outline"


def ask_shapes(
    client: Client, name: str, table: PushTable, rows: IndexArray, knowledge: Knowledge
) -> tuple[DoubleArray, DoubleArray]:
    """Return means and standard deviations (n, 3) of a version for some pushes (n,) of a table, in its frame."""
    radii, radius_index = np.unique(table.pusher_radius_m[rows], return_inverse=True)
    pairs, index = np.unique(
        np.stack([table.object_index[rows], radius_index.ravel()], axis=1), axis=0, return_inverse=True
    )
    contexts = [_context(table.objects[item], float(radii[radius]), knowledge) for item, radius in pairs.tolist()]
    corners = np.array([len(table.objects[item].outline.corners) for item in pairs[:, 0].tolist()])
    mean, std = np.empty((len(rows), 3)), np.empty((len(rows), 3))
    with tqdm(total=len(rows), desc=name, unit="push", disable=None) as bar:
        for part in _parts(index.ravel(), corners):
            used, places = np.unique(index.ravel()[part], return_inverse=True)
            pushers = table.pushers[rows[part]]
            found = client.predict_batch(
                pushers[:, :3],
                [contexts[number] for number in used.tolist()],
                places.ravel(),
                model=name,
                lengths=pushers[:, 3],
            )
            mean[part], std[part] = found.mean, found.std
            bar.update(len(part))
    return mean, std


def answering_version(client: Client, name: str) -> str:
    """Return a model's name with the number of the version that answers."""
    if "@" in name:
        return name
    model = client.show_model(name)
    return f"{name}@{model.aliases.get('champion', max(model.versions))}"


def starts_outside(table: PushTable) -> np.ndarray:
    """Return (n,) true for the pushes whose tip's centre starts outside of the object."""
    outside = np.empty(table.count, dtype=np.bool_)
    for number, item in enumerate(table.objects):
        rows = table.object_index == number
        outside[rows] = item.outline.distance_m(table.pushers[rows, :2]) > 0.0
    return outside


def _context(item: TableObject, radius_m: float, knowledge: Knowledge) -> ContextBody:
    if knowledge is Knowledge.OUTLINE:
        return ContextBody(outline=item.outline.corners.tolist())
    return ContextBody(
        outline=item.outline.corners.tolist(),
        centre_of_mass=None if item.centre_of_mass_m is None else list(item.centre_of_mass_m),
        friction=item.friction,
        pusher_radius=radius_m,
    )


def _parts(context_index: IndexArray, corners: IndexArray) -> Iterator[IndexArray]:
    """Yield rows of pushes that one request may hold, sorted by their contexts."""
    part: list[IndexArray] = []
    pushes = lists = 0
    order = np.argsort(context_index, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(context_index[order])) + 1):
        for first in range(0, len(group), MOST_PUSHES):
            chunk = group[first : first + MOST_PUSHES]
            more = len(chunk) + int(corners[context_index[chunk[0]]])
            full = pushes + len(chunk) > MOST_PUSHES or lists + more > MOST_LISTS or len(part) == MOST_SHAPES
            if part and full:
                yield np.concatenate(part)
                part, pushes, lists = [], 0, 0
            part.append(chunk)
            pushes, lists = pushes + len(chunk), lists + more
    if part:
        yield np.concatenate(part)
