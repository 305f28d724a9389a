"""Published facts of Omnipush: its splits and its statistics."""

import json
from importlib import resources

import pytest

from training.omnipush.published import (
    different_objects,
    different_surfaces,
    different_weights,
    omnipush_descriptors,
    published_normalisation,
)


def test_the_published_split_has_200_and_50_objects() -> None:
    """The published split is disjoint and covers the 250 objects of Omnipush."""
    split = different_objects()

    assert (len(set(split.train)), len(set(split.test))) == (200, 50)
    assert (len(split.train), len(split.test)) == (200, 50)
    assert not set(split.train) & set(split.test)
    assert omnipush_descriptors() == tuple(sorted({*split.train, *split.test}))


def test_surfaces_train_on_abs_and_test_on_plywood() -> None:
    """The surfaces split trains on all 250 objects and tests on 10, of which 9 are among the 250, as published."""
    split = different_surfaces()

    assert (split.name, split.test_surface) == ("different-surfaces", "plywood")
    assert split.train == omnipush_descriptors()
    assert len(split.test) == len(set(split.test)) == 10
    assert len(set(split.test) & set(split.train)) == 9


@pytest.mark.parametrize(("held_out", "objects"), [(0, 70), (1, 90), (2, 90)])
def test_weights_hold_out_all_objects_with_that_many(held_out: int, objects: int) -> None:
    """The weights splits hold out 70, 90 and 90 objects, are disjoint, and cover the 250 objects."""
    split = different_weights(held_out)

    assert (split.name, split.test_surface) == (f"different-weights-{held_out}", None)
    assert len(split.test) == objects
    assert set(split.test).isdisjoint(split.train)
    assert sorted(split.test + split.train) == list(omnipush_descriptors())
    assert {sum(letter not in "a1234" for letter in name) for name in split.test} == {held_out}
    assert {sum(letter not in "a1234" for letter in name) for name in split.train} == {0, 1, 2} - {held_out}


def test_the_normalisation_is_the_published_one() -> None:
    """The statistics are those of the facts file, and those that the design quotes."""
    facts = json.loads(resources.files("training.omnipush").joinpath("omnipush_facts.json").read_text(encoding="utf-8"))
    known = published_normalisation()

    for name in ("input_mean", "input_std", "output_mean", "output_std"):
        assert getattr(known, name).tolist() == facts["normalisation"][name], name
    assert known.input_std == pytest.approx([0.0555, 0.0565, 1.802], rel=0.001)
    assert known.output_std == pytest.approx([0.01537, 0.01563, 0.215], rel=0.001)
