"""Splits of a table: whole objects, the same on every machine."""

from pathlib import Path

import pytest

from service.errors import DataError
from tests.training.tables.tables import PUSH, corner_rows, write_folder
from training.tables.push_table import PushTable
from training.tables.reading import read_table
from training.tables.splits import split_by_column, split_by_object

NAMES = tuple(f"box{number}" for number in range(8))


@pytest.fixture
def table(tmp_path: Path) -> PushTable:
    """A table of eight objects with two pushes each; the last four are pushed on plywood once."""
    pushes = [
        {**PUSH, "object": name, "surface": "plywood" if name > "box3" and turn else "abs"}
        for turn in (0, 1)
        for name in NAMES
    ]
    return read_table(write_folder(tmp_path, pushes, [row for name in NAMES for row in corner_rows(name)]))


def names_of(table: PushTable) -> set[str]:
    """Return the names of the objects that have pushes."""
    return {table.objects[number].name for number in table.object_index.tolist()}


def test_a_split_by_object_is_the_same_everywhere(table: PushTable) -> None:
    """Split off a quarter of the objects: two whole ones, named by the hash of the seed and not by a random stream."""
    train, test = split_by_object(table, 0.25, seed=1)

    assert names_of(train) | names_of(test) == set(NAMES)
    assert not names_of(train) & names_of(test)
    assert (train.count, test.count) == (12, 4)
    assert names_of(test) == {"box2", "box3"}


def test_a_split_by_column_keeps_tested_objects_out_of_training(table: PushTable) -> None:
    """Split off plywood: the other pushes of objects tested on plywood are in neither part."""
    train, test = split_by_column(table, "surface", "plywood")

    assert names_of(test) == set(NAMES[4:])
    assert names_of(train) == set(NAMES[:4])
    assert test.surfaces == ("plywood",)


def test_a_split_that_leaves_no_object_to_train_on_is_refused(table: PushTable) -> None:
    """Refuse to test on a surface on which every object was pushed, and say how to go on."""
    with pytest.raises(DataError, match="split by object first"):
        split_by_column(table, "surface", "abs")
