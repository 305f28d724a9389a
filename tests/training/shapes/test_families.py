"""Families of shapes: their names, kinds, and the choice of some of them."""

import pytest

from service.errors import DataError
from training.shapes.families import FAMILIES, KINDS, chosen_families


def test_every_family_has_one_kind() -> None:
    """Names of families and kinds are all different, as both are options of one command."""
    names = [*KINDS, *(name for families in KINDS.values() for name in families)]

    assert len(set(names)) == len(names)
    assert len(FAMILIES) == sum(map(len, KINDS.values()))


def test_all_families_are_chosen_by_default() -> None:
    """Without any name all families are chosen, in the order of the table."""
    assert chosen_families() == tuple(FAMILIES)


def test_a_kind_stands_for_all_of_its_families() -> None:
    """A kind can be held out whole, beside a single family of another kind."""
    left = chosen_families(held_out=["tools", "star"])

    assert not {"star", *KINDS["tools"]} & set(left)
    assert len(left) == len(FAMILIES) - len(KINDS["tools"]) - 1


def test_families_are_chosen_by_name_in_the_order_of_the_table() -> None:
    """The order and the repetition of names do not matter."""
    assert chosen_families(["union", "L", "box", "L"]) == ("box", "L", "union")


def test_an_unknown_family_is_refused_with_the_names_there_are() -> None:
    """A typing error in a name is a fault, wherever it is, and the message lists the names."""
    for names, held_out in (((), ["hammr"]), (["hammr"], ())):
        with pytest.raises(DataError, match=r"'hammr' is no family.*hammer"):
            chosen_families(names, held_out)


def test_at_least_one_family_is_left() -> None:
    """Holding out all that is named is a fault."""
    with pytest.raises(DataError, match="no family of shapes is left"):
        chosen_families(["hammer", "mug"], ["tools"])
