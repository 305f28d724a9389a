"""Object identity: descriptors that a turn by whole sides makes equal, and those that stay different."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import DataError, InvalidRequestError
from service.pushing.contexts import SHAPE_DIGITS, TRIANGULAR, WEIGHT_LETTERS
from training.omnipush.object_identity import (
    canonical_descriptor,
    counted,
    find_objects,
    group_by_object,
    quarter_turns,
    shortened,
)
from training.omnipush.published import omnipush_descriptors

sides = st.sampled_from(
    [shape + weight for shape in SHAPE_DIGITS for weight in WEIGHT_LETTERS if shape == TRIANGULAR or weight in "abc"]
)
descriptors = st.lists(sides, min_size=4, max_size=4).map("".join)


@given(descriptors, st.integers(0, 3))
def test_turning_an_object_keeps_its_identity(descriptor: str, turns: int) -> None:
    """An object read from another side on has the same canonical descriptor, which is one of its four readings."""
    turned = descriptor[2 * turns :] + descriptor[: 2 * turns]

    assert canonical_descriptor(turned) == canonical_descriptor(descriptor)
    assert canonical_descriptor(descriptor) in (descriptor + descriptor)
    assert canonical_descriptor(canonical_descriptor(descriptor)) == canonical_descriptor(descriptor)
    assert quarter_turns(descriptor, turned) is not None


@pytest.mark.parametrize(
    ("descriptor", "canonical"),
    [
        ("2a3b4a1a", "1a2a3b4a"),
        ("2B1a1a1a", "1a1a1a2B"),
        ("2b1a1a1a", "1a1a1a2b"),
        ("1a2C3a2B", "1a2C3a2B"),
        ("3a2B1a2C", "1a2C3a2B"),
        ("1a2B3a2C", "1a2B3a2C"),
    ],
)
def test_letters_stay_with_their_sides(descriptor: str, canonical: str) -> None:
    """A turn moves B and C with their sides and never makes them b and c, because they mean a place in a triangle."""
    assert canonical_descriptor(descriptor) == canonical


def test_a_mirrored_object_is_another_object() -> None:
    """An object with three different sides beside a fourth is another object if it is read clockwise."""
    assert canonical_descriptor("1a2a3a4a") != canonical_descriptor("1a4a3a2a")
    assert quarter_turns("1a2a3a4a", "1a4a3a2a") is None


def test_turns_are_counted_counter_clockwise() -> None:
    """One turn by +90 degrees moves side 1 to the place of side 2."""
    assert [quarter_turns("1a2a3a4a", other) for other in ("1a2a3a4a", "4a1a2a3a", "3a4a1a2a", "2a3a4a1a")] == [
        0,
        1,
        2,
        3,
    ]


def test_an_impossible_object_has_no_canonical_descriptor() -> None:
    """A descriptor with B on a side that is not a triangle is refused."""
    with pytest.raises(InvalidRequestError, match="side 1"):
        canonical_descriptor("1B2a3a4a")


def test_the_250_objects_are_250_different_ones() -> None:
    """No object of the benchmark is another one turned, so membership is unambiguous."""
    assert all(len(names) == 1 for names in group_by_object(omnipush_descriptors()).values())
    assert len(group_by_object(omnipush_descriptors())) == 250


def test_objects_are_found_under_the_descriptors_of_their_files() -> None:
    """Objects are found in the order wanted, and a turned object keeps the descriptor of its file."""
    assert find_objects(["1a2a3b4a", "4a4a4a4a"], ["4a4a4a4a", "3a3a3a3a", "2a3b4a1a"]) == ["2a3b4a1a", "4a4a4a4a"]


def test_two_files_of_one_object_are_refused() -> None:
    """Two files of one object are refused even if one has the published descriptor, as either may be the object."""
    with pytest.raises(DataError, match=r"1a2a3a4a and 2a3a4a1a are the same object.*keep the files of one"):
        find_objects(["1a2a3a4a"], ["1a2a3a4a", "2a3a4a1a"])


def test_two_files_of_an_object_that_is_not_wanted_are_ignored() -> None:
    """A search checks only the objects that are wanted."""
    assert find_objects(["4a4a4a4a"], ["1a2a3a4a", "2a3a4a1a", "4a4a4a4a"]) == ["4a4a4a4a"]


def test_long_lists_are_shortened() -> None:
    """A long list of descriptors is cut after the first few, and an ellipsis marks the rest."""
    assert shortened(["a", "b"], 2) == "a, b"
    assert shortened(["a", "b", "c"], 2) == "a, b ..."
    assert [counted(["a"]), counted(["a", "b"])] == ["1 object (a)", "2 objects (a, b)"]
