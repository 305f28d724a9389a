"""Table of pushes in memory: rows, objects and texts that belong together."""

import numpy as np

from service.pushing.outlines import Outline
from tests.training.tables.tables import BOX, WEDGE, pushed_table
from training.tables.push_table import TextColumn, content_digest


def test_selected_rows_keep_their_own_object() -> None:
    """Select pushes of one of two objects in another order: the other object is left out, the rows stay whole."""
    table = pushed_table({"wedge": Outline.of(WEDGE), "box": Outline.of(BOX)}, 5)
    chosen = table.select(np.array([9, 6]))

    assert [item.name for item in chosen.objects] == ["box"]
    assert chosen.object_index.tolist() == [0, 0]
    np.testing.assert_array_equal(chosen.pushers, table.pushers[[9, 6]])
    np.testing.assert_array_equal(chosen.outcomes, table.outcomes[[9, 6]])


def test_a_column_of_texts_keeps_the_values_that_occur() -> None:
    """Select rows of a column: values that no row holds any more are left out, and none is equal to an unknown one."""
    column = TextColumn(("a", "b", "c"), np.array([2, 0, 2, 1]))
    chosen = column.select(np.array([True, False, True, True]))

    assert (chosen.values, chosen.index.tolist()) == (("b", "c"), [1, 1, 0])
    assert chosen.equal("c").tolist() == [True, True, False]
    assert not chosen.equal("a").any()


def test_the_digest_tells_tables_apart() -> None:
    """Compute another digest after a change of the last digit of one number."""
    table = pushed_table({"box": Outline.of(BOX)}, 5)
    before = content_digest(table)
    table.outcomes[2, 1] = np.nextafter(table.outcomes[2, 1], 1.0)
    assert content_digest(table) != before
