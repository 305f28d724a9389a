"""Object contexts: descriptor, indicator, visual context, and the index of each push's context."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import InvalidRequestError
from service.model.tensors import ContextKind
from service.pushing.contexts import INDICATOR_LENGTH, ObjectContext, SupportContext, VisualContext, index_contexts

sides = st.tuples(st.sampled_from("134"), st.sampled_from("abc")) | st.tuples(st.just("2"), st.sampled_from("abcBC"))
descriptors = st.lists(sides, min_size=4, max_size=4).map(
    lambda four: "".join(shape + weight for shape, weight in four)
)


@given(descriptors)
def test_descriptor_and_indicator_are_two_forms_of_one_object(descriptor: str) -> None:
    """Both round trips hold: an object is read back from its descriptor and from its indicator."""
    context = ObjectContext.from_descriptor(descriptor)
    assert context.descriptor() == descriptor
    assert context.indicator().shape == (INDICATOR_LENGTH,)
    assert ObjectContext.from_indicator(context.indicator().tolist()) == context


def test_the_indicator_is_shape_then_weight_of_each_side() -> None:
    """The indicator of 1a2B3b4c has for each side its shape one-hot, then its weight one-hot."""
    sides = ["1000 10000", "0100 00010", "0010 01000", "0001 00100"]
    expected = [int(bit) for bit in "".join(sides).replace(" ", "")]
    assert ObjectContext.from_descriptor("1a2B3b4c").indicator().tolist() == expected
    assert ObjectContext.from_descriptor("1a2B3b4c").indicator().dtype == np.float32


def test_an_object_turned_by_a_quarter_has_its_first_side_second() -> None:
    """A quarter turn counter-clockwise moves side 1 to the place of side 2."""
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
    """An invalid descriptor is refused with the faulty side, the received and the accepted value."""
    with pytest.raises(InvalidRequestError) as caught:
        ObjectContext.from_descriptor(descriptor)
    assert [(fault.where, fault.received) for fault in caught.value.faults] == [(where, received)]
    assert caught.value.faults[0].accepted


def _indicator(**changes: float) -> list[float]:
    """Return the indicator of 1a2b3c4a with some bits changed."""
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
    """A side without exactly one shape and one weight is refused by its number."""
    with pytest.raises(InvalidRequestError) as caught:
        ObjectContext.from_indicator(indicator)
    assert [(fault.where, fault.received) for fault in caught.value.faults] == [(where, received)]


def test_every_faulty_side_is_named_at_once() -> None:
    """All faulty sides are named in one error."""
    with pytest.raises(InvalidRequestError) as caught:
        ObjectContext.from_indicator([0] * 36)
    assert [fault.where for fault in caught.value.faults] == [f"indicator side {number}" for number in (1, 2, 3, 4)]


def test_a_visual_context_is_its_grey_levels_row_by_row() -> None:
    """A visual context is 1,024 bytes, row by row, where 255 means 1. Its kind is visual."""
    view = VisualContext.from_bytes(bytes(range(256)) * 4)
    assert view.kind is ContextKind.VISUAL
    assert view.tensor().shape == (1, 32, 32)
    assert view.tensor().dtype == np.float32
    assert view.tensor()[0, 7, 31] == 1.0
    assert view.tensor()[0, 1, 0] == np.float32(32.0) / np.float32(255.0)


@pytest.mark.parametrize("size", [0, 1023, 1025])
def test_a_visual_context_of_another_size_is_refused(size: int) -> None:
    """A visual context of another size is refused with the received and the accepted number of bytes."""
    with pytest.raises(InvalidRequestError, match=rf"{size} bytes.*1024 bytes"):
        VisualContext.from_bytes(bytes(size))


def test_a_support_is_padded_and_says_which_rows_are_pushes() -> None:
    """A support is 50 rows of pushers and outcomes with wrapped angles. Rows after its pushes are zeros."""
    support = SupportContext.of(np.array([[-0.08, 0.0, 7.0], [0.0, -0.08, 1.5]]), np.array([[0.02, 0.0, 0.1]] * 2))
    pushers, outcomes, valid = support.tensors()
    assert support.kind is ContextKind.SUPPORT
    assert (pushers.shape, outcomes.shape, valid.shape) == ((50, 3), (50, 3), (50,))
    assert {tensor.dtype for tensor in (pushers, outcomes, valid)} == {np.dtype(np.float32)}
    assert pushers[0].tolist() == pytest.approx([-0.08, 0.0, 7.0 - 2.0 * np.pi])
    assert outcomes[1].tolist() == pytest.approx([0.02, 0.0, 0.1])
    assert valid.tolist() == [1.0, 1.0] + [0.0] * 48
    assert not pushers[2:].any()
    assert not outcomes[2:].any()


@pytest.mark.parametrize(
    ("pushers", "outcomes", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), r"^support\.pushers: received 0 pushes; accepted is 1 to 50"),
        (np.zeros((51, 3)), np.zeros((51, 3)), r"^support\.pushers: received 51 pushes; accepted is 1 to 50"),
        (np.zeros((2, 3)), np.zeros((1, 3)), r"^support\.outcomes: received 1 outcomes; accepted is as many"),
        (np.array([[0.0, 0.0, 0.0], [0.0, 1.5, 0.0]]), np.zeros((2, 3)), r"^support\.pushers\.1: received 1\.5 m"),
        (np.zeros((1, 3)), np.array([[-2.0, 0.0, 0.0]]), r"^support\.outcomes\.0: received -2 m"),
    ],
    ids=["none", "too many", "fewer outcomes", "a pusher out of reach", "an outcome out of reach"],
)
def test_an_impossible_support_is_refused_by_its_row(
    pushers: np.ndarray[Any, Any], outcomes: np.ndarray[Any, Any], message: str
) -> None:
    """A support without pushes, with too many, without an outcome, or with one out of reach names field and row."""
    with pytest.raises(InvalidRequestError, match=message):
        SupportContext.of(pushers, outcomes)


FIELDS = ("body.contexts", "body.context_index")
as_list_or_array = pytest.mark.parametrize("container", [list, np.array], ids=["list", "array"])


@pytest.mark.parametrize(
    ("contexts", "pushes"), [(1, 1), (1, 4), (4, 4)], ids=["single", "one for all", "one per push"]
)
def test_an_index_that_is_left_out_follows_from_the_number_of_contexts(contexts: int, pushes: int) -> None:
    """One context belongs to every push, and as many contexts as pushes belong to one push each."""
    index = index_contexts(contexts, pushes, None, FIELDS)
    assert index.dtype == np.int64
    assert index.tolist() == ([0] * pushes if contexts == 1 else list(range(pushes)))


@pytest.mark.parametrize("contexts", [0, 2, 5])
def test_another_number_of_contexts_needs_an_index(contexts: int) -> None:
    """Neither one context nor one per push is refused when the index is left out."""
    with pytest.raises(InvalidRequestError) as caught:
        index_contexts(contexts, 4, None, FIELDS)
    (fault,) = caught.value.faults
    assert (fault.where, fault.received) == ("body.contexts", f"{contexts} contexts")


@as_list_or_array
def test_an_index_names_the_context_of_each_push(container: Callable[[list[int]], Any]) -> None:
    """An index from 0 is returned as int64, for lists and for arrays, with contexts in any order."""
    index = index_contexts(3, 4, container([2, 0, 2, 1]), FIELDS)
    assert index.dtype == np.int64
    assert index.tolist() == [2, 0, 2, 1]


@as_list_or_array
@pytest.mark.parametrize("given", [[0, 1], [0, 1, 2, 0, 1]], ids=["too short", "too long"])
def test_an_index_of_another_length_is_refused(container: Callable[[list[int]], Any], given: list[int]) -> None:
    """An index that has not one value per push is refused with both numbers."""
    with pytest.raises(InvalidRequestError) as caught:
        index_contexts(3, 4, container(given), FIELDS)
    (fault,) = caught.value.faults
    assert (fault.where, fault.received) == ("body.context_index", f"{len(given)} values")
    assert fault.accepted == "4 values: one per push"


@as_list_or_array
@pytest.mark.parametrize(
    "value",
    [3, -1, 2**62, -(2**63), 2**63, 2**64, -(2**70), 10**400],
    ids=["one beyond", "negative", "large", "least of int64", "beyond int64", "beyond uint64", "below int64", "huge"],
)
def test_an_index_outside_the_contexts_is_refused_by_its_place(
    container: Callable[[list[int]], Any], value: int
) -> None:
    """The first value that is not from 0 to the last context is refused by its place, however large it is."""
    with pytest.raises(InvalidRequestError) as caught:
        index_contexts(3, 4, container([0, 2, value, value]), FIELDS)
    (fault,) = caught.value.faults
    assert (fault.where, fault.accepted) == ("body.context_index.2", "0 to 2")
    assert str(value) not in str(caught.value) or abs(value) < 4
