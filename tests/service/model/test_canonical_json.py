"""Canonical JSON, compared with the text of the standard library."""

import json
from dataclasses import asdict, dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.model.canonical_json import canonical

TEXTS = st.text(st.characters(codec="utf-8"))
NUMBERS = st.integers() | st.floats(allow_nan=False, allow_infinity=False)
DOCUMENTS = st.recursive(
    st.none() | st.booleans() | NUMBERS | TEXTS | st.lists(NUMBERS),
    lambda parts: st.lists(parts) | st.dictionaries(TEXTS, parts) | st.lists(parts).map(tuple),
)


@dataclass(frozen=True)
class Part:
    """A part of a record, its fields out of order."""

    name: str
    amounts: list[float]


@dataclass(frozen=True)
class Whole:
    """A record of records."""

    parts: tuple[Part, ...]
    by_name: dict[str, Part]
    last: Part


def by_the_standard_library(document: object) -> bytes:
    """Return the text of ``json.dumps``, which every published digest was made of."""
    text = json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()


@given(DOCUMENTS)
def test_the_text_is_that_of_the_standard_library(document: Any) -> None:
    """Every document is written as ``json.dumps`` writes it, to the byte, with any nesting, number or text."""
    assert canonical(document) == by_the_standard_library(document)


def test_a_record_is_written_as_its_fields_sorted() -> None:
    """A dataclass is written as an object with sorted fields, in tuples, mappings and other dataclasses too."""
    part = Part("b", [1e-05, 1e16, -0.0])
    whole = Whole((part, Part("", [])), {"z": part, "a": part}, part)
    assert canonical(whole) == by_the_standard_library(asdict(whole))


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("others", [[], [1.0], ["text"]], ids=["alone", "in a row", "beside a text"])
def test_a_number_that_is_not_finite_is_refused(number: float, others: list[object]) -> None:
    """NaN and infinity are refused, because JSON cannot express them."""
    with pytest.raises(ValueError, match="not a JSON number"):
        canonical([*others, number])


@pytest.mark.parametrize("document", [{1, 2}, b"bytes", Part], ids=["set", "bytes", "class"])
def test_a_value_without_a_json_type_is_refused(document: object) -> None:
    """Sets, bytes and classes are refused, and the error names the type."""
    with pytest.raises(TypeError, match="has no canonical text"):
        canonical(document)
