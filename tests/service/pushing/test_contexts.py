"""Poses, angles and object contexts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import InvalidRequestError
from service.model.tensors import ContextKind
from service.pushing.contexts import INDICATOR_LENGTH, ObjectContext, VisualContext
from service.pushing.poses import wrap_angle

sides = st.tuples(st.sampled_from("134"), st.sampled_from("abc")) | st.tuples(st.just("2"), st.sampled_from("abcBC"))
descriptors = st.lists(sides, min_size=4, max_size=4).map(
    lambda four: "".join(shape + weight for shape, weight in four)
)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_wrapped_angle_is_the_same_direction_in_the_half_open_interval(angle: float) -> None:
    """Any finite angle ends up in (-pi, pi], pointing where it pointed."""
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    exact = math.remainder(angle, 2 * math.pi)  # the IEEE remainder is exact, whatever the size
    assert math.isclose(math.cos(wrapped), math.cos(exact), abs_tol=1e-12)
    assert math.isclose(math.sin(wrapped), math.sin(exact), abs_tol=1e-12)


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(math.pi, math.pi), (-math.pi, math.pi), (3 * math.pi, math.pi), (0.5, 0.5), (2 * math.pi, 0.0)],
    ids=["pi stays", "-pi is pi", "three half turns", "inside stays", "a whole turn is none"],
)
def test_angles_at_the_border_have_one_value(angle: float, expected: float) -> None:
    """Both names of the same border direction become pi."""
    assert wrap_angle(angle) == pytest.approx(expected, abs=1e-15)


@given(descriptors)
def test_descriptor_and_indicator_are_two_texts_of_one_object(descriptor: str) -> None:
    """Both round trips hold."""
    context = ObjectContext.from_descriptor(descriptor)
    assert context.descriptor() == descriptor
    assert context.indicator().shape == (INDICATOR_LENGTH,)
    assert ObjectContext.from_indicator(context.indicator().tolist()) == context


def test_the_indicator_is_shape_then_weight_of_each_side() -> None:
    """The bits of 1a2B3b4c stand where the contract puts them."""
    sides = ["1000 10000", "0100 00010", "0010 01000", "0001 00100"]
    expected = [int(bit) for bit in "".join(sides).replace(" ", "")]
    assert ObjectContext.from_descriptor("1a2B3b4c").indicator().tolist() == expected
    assert ObjectContext.from_descriptor("1a2B3b4c").indicator().dtype == np.float32


def test_an_object_turned_by_a_quarter_has_its_first_side_second() -> None:
    """Turning counter-clockwise moves side 1 to where side 2 was."""
    context = ObjectContext.from_descriptor("1a2b3c4a")
    assert context.turned(1).descriptor() == "4a1a2b3c"
    assert context.turned(4) == context.turned(0) == context
    assert context.turned(-1).turned(1) == context


@pytest.mark.parametrize(
    ("descriptor", "where", "received"),
    [
        ("1a2b3c4", "descriptor", "7 characters"),
        ("", "descriptor", "0 characters"),
        ("1a2b5c4a", "descriptor side 3", "an unknown shape"),
        ("1a2d3c4a", "descriptor side 2", "an unknown weight"),
        ("1B2b3c4a", "descriptor side 1", "weight B on shape 1"),
        ("1a2b3c4\ud800", "descriptor side 4", "an unknown weight"),
        ("1a2b3c٤a", "descriptor side 4", "an unknown shape"),
    ],
    ids=["too short", "empty", "shape 5", "weight d", "B on a concave side", "lone surrogate", "foreign digit"],
)
def test_a_descriptor_that_is_no_object_names_the_side(descriptor: str, where: str, received: str) -> None:
    """The error says which side, what came and what would be taken."""
    with pytest.raises(InvalidRequestError) as caught:
        ObjectContext.from_descriptor(descriptor)
    assert [(fault.where, fault.received) for fault in caught.value.faults] == [(where, received)]
    assert caught.value.faults[0].accepted


def _indicator(**changes: float) -> list[float]:
    bits: list[float] = ObjectContext.from_descriptor("1a2b3c4a").indicator().tolist()
    for place, value in changes.items():
        bits[int(place.removeprefix("bit"))] = value
    return bits


@pytest.mark.parametrize(
    ("indicator", "where", "received"),
    [
        (_indicator(bit1=1), "indicator side 1", "2 shapes (1, 2)"),
        (_indicator(bit10=0), "indicator side 2", "0 shapes"),
        (_indicator(bit22=1), "indicator side 3", "2 weights (a, c)"),
        (_indicator(bit31=0), "indicator side 4", "0 weights"),
        (_indicator(bit0=0.5), "indicator side 1", "a value other than 0 and 1"),
        (_indicator(bit4=0, bit7=1), "indicator side 1", "weight B on shape 1"),
        ([0] * 35, "indicator", "35 values"),
    ],
    ids=["two shapes", "no shape", "two weights", "no weight", "a half", "B on a concave side", "35 values"],
)
def test_an_indicator_that_is_no_object_names_the_side(indicator: list[float], where: str, received: str) -> None:
    """Exactly one shape and one weight per side, or the side is named."""
    with pytest.raises(InvalidRequestError) as caught:
        ObjectContext.from_indicator(indicator)
    assert [(fault.where, fault.received) for fault in caught.value.faults] == [(where, received)]


def test_every_faulty_side_is_named_at_once() -> None:
    """A caller mends all sides in one round."""
    with pytest.raises(InvalidRequestError) as caught:
        ObjectContext.from_indicator([0] * 36)
    assert [fault.where for fault in caught.value.faults] == [f"indicator side {number}" for number in (1, 2, 3, 4)]


def test_a_visual_context_is_its_grey_levels_row_by_row() -> None:
    """Byte 255 is 1, the second row begins at byte 32, and the kind is visual."""
    view = VisualContext.from_bytes(bytes(range(256)) * 4)
    assert view.kind is ContextKind.VISUAL
    assert view.tensor().shape == (1, 32, 32)
    assert view.tensor().dtype == np.float32
    assert view.tensor()[0, 7, 31] == 1.0
    assert view.tensor()[0, 1, 0] == np.float32(32.0) / np.float32(255.0)


@pytest.mark.parametrize("size", [0, 1023, 1025])
def test_a_visual_context_of_another_size_is_refused(size: int) -> None:
    """The message says how many bytes came and how many it must be."""
    with pytest.raises(InvalidRequestError, match=rf"{size} bytes.*1024 bytes"):
        VisualContext.from_bytes(bytes(size))
