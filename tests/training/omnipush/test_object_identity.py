"""Kinds of object: what turning by whole sides changes, and what it does not."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import DataError, InvalidRequestError
from service.pushing.contexts import SHAPE_DIGITS, TRIANGULAR, WEIGHT_LETTERS
from training.omnipush.object_identity import by_kind, canonical_descriptor, find_kinds, named, quarter_turns, shortened
from training.omnipush.published import omnipush_descriptors

sides = st.sampled_from(
    [shape + weight for shape in SHAPE_DIGITS for weight in WEIGHT_LETTERS if shape == TRIANGULAR or weight in "abc"]
)
descriptors = st.lists(sides, min_size=4, max_size=4).map("".join)


@given(descriptors, st.integers(0, 3))
def test_turning_an_object_keeps_its_kind(descriptor: str, turns: int) -> None:
    """Starting to read at another side gives the same canonical name, which is one of the four readings."""
    turned = descriptor[2 * turns :] + descriptor[: 2 * turns]

    assert canonical_descriptor(turned) == canonical_descriptor(descriptor)
    assert canonical_descriptor(descriptor) in (descriptor + descriptor)
    assert canonical_descriptor(canonical_descriptor(descriptor)) == canonical_descriptor(descriptor)
    assert quarter_turns(descriptor, turned) is not None


@pytest.mark.parametrize(
    ("descriptor", "kind"),
    [
        ("2a3b4a1a", "1a2a3b4a"),
        ("2B1a1a1a", "1a1a1a2B"),
        ("2b1a1a1a", "1a1a1a2b"),
        ("1a2C3a2B", "1a2C3a2B"),
        ("3a2B1a2C", "1a2C3a2B"),
        ("1a2B3a2C", "1a2B3a2C"),
    ],
)
def test_letters_stay_with_their_sides(descriptor: str, kind: str) -> None:
    """B and C name a place within a triangle: a turn moves them with it, and never makes them b and c."""
    assert canonical_descriptor(descriptor) == kind


def test_a_mirrored_object_is_another_kind() -> None:
    """Read clockwise, three different sides beside a fourth are another object."""
    assert canonical_descriptor("1a2a3a4a") != canonical_descriptor("1a4a3a2a")
    assert quarter_turns("1a2a3a4a", "1a4a3a2a") is None


def test_turns_are_counted_counter_clockwise() -> None:
    """One turn by +90 degrees brings side 1 to where side 2 was."""
    assert [quarter_turns("1a2a3a4a", other) for other in ("1a2a3a4a", "4a1a2a3a", "3a4a1a2a", "2a3a4a1a")] == [
        0,
        1,
        2,
        3,
    ]


def test_an_impossible_object_has_no_kind() -> None:
    """B belongs on triangles."""
    with pytest.raises(InvalidRequestError, match="side 1"):
        canonical_descriptor("1B2a3a4a")


def test_the_250_objects_are_250_kinds() -> None:
    """No object of the benchmark is another one turned, so membership by kind is unambiguous."""
    assert all(len(names) == 1 for names in by_kind(omnipush_descriptors()).values())
    assert len(by_kind(omnipush_descriptors())) == 250


def test_objects_are_found_under_the_names_they_have() -> None:
    """In the order wanted; a turned object keeps the name of its file."""
    assert find_kinds(["1a2a3b4a", "4a4a4a4a"], ["4a4a4a4a", "3a3a3a3a", "2a3b4a1a"]) == ["2a3b4a1a", "4a4a4a4a"]


def test_two_files_of_one_kind_are_refused() -> None:
    """Neither can be told to be the published object, even if one has its very name."""
    with pytest.raises(DataError, match=r"1a2a3a4a and 2a3a4a1a are the same kind.*keep the files of one"):
        find_kinds(["1a2a3a4a"], ["1a2a3a4a", "2a3a4a1a"])


def test_two_files_of_a_kind_that_is_not_wanted_do_no_harm() -> None:
    """Only what is asked for is looked at."""
    assert find_kinds(["4a4a4a4a"], ["1a2a3a4a", "2a3a4a1a", "4a4a4a4a"]) == ["4a4a4a4a"]


def test_long_lists_are_shortened() -> None:
    """The first few and a sign that there are more."""
    assert shortened(["a", "b"], 2) == "a, b"
    assert shortened(["a", "b", "c"], 2) == "a, b ..."
    assert [named(["a"]), named(["a", "b"])] == ["1 object (a)", "2 objects (a, b)"]
