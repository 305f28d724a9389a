"""Rows of a batch: the quick conversion accepts, reads and refuses exactly as the documented type does."""

from typing import Any

import numpy as np
import pydantic_core
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ConfigDict, TypeAdapter, ValidationError

from service.pushing.poses import DoubleArray
from service.schemas.rows import MAX_PUSHES, DocumentedRows, Rows

STRICT = ConfigDict(strict=True, allow_inf_nan=False)
READER: TypeAdapter[DoubleArray] = TypeAdapter(Rows, config=STRICT)
DOCUMENTED = TypeAdapter(DocumentedRows, config=STRICT)

numbers = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.floats(-1.0, 1.0).map(lambda value: f"{value:.25f}"),
    st.integers().map(str),
    st.integers(-(2**70), 2**70).map(str),
    st.from_regex(r"-?(0|[1-9][0-9]{0,30})(\.[0-9]{1,40})?([eE][+-]?[0-9]{1,3})?", fullmatch=True),
)
LITERALS = ["true", "false", "null", "NaN", "-Infinity", "1e999", "-0", "01", "1.", '"1"', '"abc"']
odd = st.sampled_from([*LITERALS, "[]", "{}", '{"a": 1}', "9" * 400, "1" + "0" * 5000, "[1, 2, 3]", "[0.5]"])
rows = st.lists(numbers, min_size=3, max_size=3).map(lambda row: f"[{', '.join(row)}]")
odd_rows = st.one_of(odd, st.lists(st.one_of(numbers, odd), max_size=4).map(lambda row: f"[{','.join(row)}]"))
columns = st.one_of(
    st.lists(rows, min_size=1, max_size=6), st.lists(st.one_of(rows, odd_rows), max_size=4), st.lists(rows, max_size=1)
).map(lambda lines: f"[{', '.join(lines)}]")


def by_the_documented_type(text: str) -> bytes | None:
    """Return the numbers that the documented type reads, or None if it refuses."""
    try:
        return np.array(DOCUMENTED.validate_python(pydantic_core.from_json(text)), dtype=np.float64).tobytes()
    except ValueError:
        return None


def by_rows(text: str) -> bytes | None:
    """Return the numbers that ``Rows`` reads, or None if it refuses."""
    try:
        return READER.validate_python(pydantic_core.from_json(text)).tobytes()
    except ValueError:
        return None


def faults(adapter: TypeAdapter[Any], document: Any) -> str:
    """Return the faults that a type finds in a document."""
    try:
        adapter.validate_python(document)
    except ValidationError as error:
        return repr(error.errors(include_url=False))
    return "none"


@settings(max_examples=1000, deadline=None)
@given(columns)
def test_rows_accept_and_read_the_numbers_of_the_documented_type(text: str) -> None:
    """Any text is read to the same numbers, to the bit, or refused by both."""
    assert by_rows(text) == by_the_documented_type(text)


@settings(max_examples=300, deadline=None)
@given(columns)
def test_a_refusal_is_in_the_words_of_the_documented_type(text: str) -> None:
    """Any refused text has the same faults at the same places."""
    try:
        document = pydantic_core.from_json(text)
    except ValueError:
        return
    assert faults(READER, document) == faults(DOCUMENTED, document)


@pytest.mark.parametrize(
    "received", [[(0.5, 0.5, 0.5)], ([0.5, 0.5, 0.5],), ["abc"], [{1: 0, 2: 0, 3: 0}], [[True, 0.5, 0.5]], "", None, []]
)
def test_python_values_that_resemble_rows_are_refused(received: Any) -> None:
    """Tuples, texts, mappings and booleans are refused, although Python iterates or packs them like rows."""
    with pytest.raises(ValidationError):
        READER.validate_python(received)


def test_the_largest_number_of_rows_is_read_and_one_more_is_refused() -> None:
    """A batch of 10,000 rows is read, and one of 10,001 is refused."""
    assert READER.validate_python([[0.5, 0.5, 0.5]] * MAX_PUSHES).shape == (MAX_PUSHES, 3)
    with pytest.raises(ValidationError):
        READER.validate_python([[0.5, 0.5, 0.5]] * (MAX_PUSHES + 1))
