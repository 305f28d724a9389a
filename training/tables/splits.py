"""Splits of a table into training and test, by whole objects.

The same table and arguments give the same split on every machine and under every version of numpy: objects are ordered
by a hash of the seed and their names.
"""

import hashlib

import numpy as np

from service.errors import DataError
from training.tables.push_table import PushTable


def split_by_object(table: PushTable, share: float, seed: int = 0) -> tuple[PushTable, PushTable]:
    """Split a table into training and test by objects, which are chosen by a seed.

    The order of the rows and of the objects does not matter.

    Args:
        table: the table.
        share: share of the objects to test, above 0 and below 1. Each part has at least one object.
        seed: the choice of objects.

    Returns:
        The pushes to train on, and those to test on.

    Raises:
        DataError: the table has pushes of fewer than two objects, or the share is no share.
    """
    if not 0.0 < share < 1.0:
        raise DataError(f"share: received {share:g}; accepted is a number above 0 and below 1")
    names = [table.objects[number].name for number in np.unique(table.object_index).tolist()]
    if len(names) < 2:
        raise DataError(f"a split by object needs pushes of 2 objects; the table has {len(names)}: push another one")
    ordered = sorted(names, key=lambda name: (hashlib.sha256(f"{seed}\0{name}".encode()).digest(), name))
    tested = set(ordered[: min(max(round(share * len(names)), 1), len(names) - 1)])
    by_object = np.array([item.name in tested for item in table.objects])
    rows = by_object[table.object_index]
    return table.select(~rows), table.select(rows)


def split_by_column(table: PushTable, column: str, value: str) -> tuple[PushTable, PushTable]:
    """Split a table into training and test by the value of a column: object, surface, or another one with texts.

    The test has the pushes with the value. Training has the other pushes, less those of tested objects.

    Args:
        table: the table.
        column: the column.
        value: its value in the rows to test.

    Returns:
        The pushes to train on, and those to test on.

    Raises:
        DataError: there is no such column or value, or no object is left to train on.
    """
    test = rows_with(table, column, value)
    tested = {item.name for item in test.objects}
    by_object = np.array([item.name in tested for item in table.objects])
    rows = ~by_object[table.object_index]
    if not rows.any():
        raise DataError(
            f"every object has pushes with {column} {value!r}, so none is left to train on; "
            "split by object first, then choose the rows of each part by this column"
        )
    return table.select(rows), test


def rows_with(table: PushTable, column: str, value: str) -> PushTable:
    """Return the pushes that have a value in a column.

    Raises:
        DataError: there is no such column or value. The message lists those that there are.
    """
    columns = table.text_columns
    if column not in columns:
        raise DataError(f"column: received {column!r}; accepted is one of {', '.join(columns)}")
    rows = columns[column].equal(value)
    if not rows.any():
        there = ", ".join(columns[column].values[:20])
        raise DataError(f"{column}: received {value!r}, which no push has; accepted is one of {there[:300]}")
    return table.select(rows)
