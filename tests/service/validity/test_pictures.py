"""Faults of pictures, as warnings."""

from dataclasses import replace

import numpy as np

from service.inference.query import ContextBatch
from service.model.tensors import ContextKind
from service.pushing.image_quality import QualityFlag
from service.validity.codes import MEANINGS, WarningCode
from service.validity.pictures import PICTURES, flags_of

INDEX = np.zeros(1, dtype=np.int64)


def views(*boxes: tuple[slice, slice]) -> ContextBatch:
    """Return a batch of views, each of one grey box on black."""
    levels = np.zeros((len(boxes), 1, 32, 32), dtype=np.float32)
    for number, (rows, columns) in enumerate(boxes):
        levels[number, 0, rows, columns] = 0.5
    return ContextBatch(ContextKind.VISUAL, (levels,), INDEX, "body.contexts")


def test_every_flag_has_a_warning_of_its_own() -> None:
    """Each fault is a code that is explained, and the sentence says how to take a better picture."""
    assert set(PICTURES) == set(QualityFlag)
    codes = [code for code, _ in PICTURES.values()]
    assert len(set(codes)) == len(codes)
    assert set(MEANINGS) == set(WarningCode)
    assert all(code.value == f"image_{flag.value}" for flag, (code, _) in PICTURES.items())
    assert all(": " in sentence for _, sentence in PICTURES.values())


def test_views_are_judged_each_by_itself() -> None:
    """A box in the middle has no fault, nothing at all is blank, and a box at the border is clipped."""
    middle, nothing, border = (slice(8, 24), slice(8, 24)), (slice(0), slice(0)), (slice(8, 24), slice(0, 24))
    found = flags_of(views(middle, nothing, border))
    assert [tuple(flag.value for flag in of_one) for of_one in found] == [(), ("blank",), ("clipped", "off_centre")]


def test_many_views_are_judged_with_pauses_in_between() -> None:
    """Beyond the views between two pauses, the flags are still in the order of the contexts."""
    batch = views(*[(slice(8, 24), slice(8, 24))] * 130)
    batch.tensors[0][129] = 0.0
    found = flags_of(batch)
    assert [bool(of_one) for of_one in found] == [False] * 129 + [True]


def test_shapes_have_the_flags_of_their_photographs() -> None:
    """For any other kind the flags are those that were raised while the picture was read."""
    shapes = ContextBatch(ContextKind.SHAPE, (), INDEX, "body.contexts", ((QualityFlag.SEVERAL_OBJECTS,),))
    assert flags_of(shapes) == ((QualityFlag.SEVERAL_OBJECTS,),)
    assert not flags_of(replace(shapes, flags=()))
