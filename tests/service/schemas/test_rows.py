"""Rows read by the short way are those that pydantic reads: what is accepted, to the bit, and what is refused."""

import json
from typing import Any

import numpy as np
import pydantic_core
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ConfigDict, TypeAdapter, ValidationError

from service.errors import CazslError
from service.pushing.poses import DoubleArray
from service.schemas.body import parse_json, validate_body
from service.schemas.pushes import BatchRequest
from service.schemas.rows import MAX_PUSHES, DocumentedRows, Rows

STRICT = ConfigDict(strict=True, allow_inf_nan=False)
READER: TypeAdapter[DoubleArray] = TypeAdapter(Rows, config=STRICT)
JUDGE = TypeAdapter(DocumentedRows, config=STRICT)

numbers = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.floats(-1.0, 1.0).map(lambda value: f"{value:.25f}"),
    st.integers().map(str),
    st.integers(-(2**70), 2**70).map(str),
    st.from_regex(r"-?(0|[1-9][0-9]{0,30})(\.[0-9]{1,40})?([eE][+-]?[0-9]{1,3})?", fullmatch=True),
)
WORDS = ["true", "false", "null", "NaN", "-Infinity", "1e999", "-0", "01", "1.", '"1"', '"abc"']
odd = st.sampled_from([*WORDS, "[]", "{}", '{"a": 1}', "9" * 400, "1" + "0" * 5000, "[1, 2, 3]", "[0.5]"])
rows = st.lists(numbers, min_size=3, max_size=3).map(lambda row: f"[{', '.join(row)}]")
odd_rows = st.one_of(odd, st.lists(st.one_of(numbers, odd), max_size=4).map(lambda row: f"[{','.join(row)}]"))
columns = st.one_of(
    st.lists(rows, min_size=1, max_size=6), st.lists(st.one_of(rows, odd_rows), max_size=4), st.lists(rows, max_size=1)
).map(lambda lines: f"[{', '.join(lines)}]")


def judged(text: str) -> bytes | None:
    """The numbers that the documented type has, or nothing where it refuses."""
    try:
        return np.array(JUDGE.validate_python(pydantic_core.from_json(text)), dtype=np.float64).tobytes()
    except ValueError:
        return None


def read(text: str) -> bytes | None:
    """The same by the short way."""
    try:
        return READER.validate_python(pydantic_core.from_json(text)).tobytes()
    except ValueError:
        return None


def faults(adapter: TypeAdapter[Any], document: Any) -> str:
    """What a type says of a document."""
    try:
        adapter.validate_python(document)
    except ValidationError as error:
        return repr(error.errors(include_url=False))
    return "none"


@settings(max_examples=1000, deadline=None)
@given(columns)
def test_both_ways_accept_the_same_and_read_the_same_numbers(text: str) -> None:
    """Whatever is written, and however long."""
    assert read(text) == judged(text)


@settings(max_examples=300, deadline=None)
@given(columns)
def test_a_refusal_is_in_the_words_of_the_documented_type(text: str) -> None:
    """The same faults at the same places."""
    try:
        document = pydantic_core.from_json(text)
    except ValueError:
        return
    assert faults(READER, document) == faults(JUDGE, document)


@pytest.mark.parametrize(
    "received", [[(0.5, 0.5, 0.5)], ([0.5, 0.5, 0.5],), ["abc"], [{1: 0, 2: 0, 3: 0}], [[True, 0.5, 0.5]], "", None, []]
)
def test_what_only_looks_like_rows_is_refused(received: Any) -> None:
    """Python takes more for lists and numbers than JSON has."""
    with pytest.raises(ValidationError):
        READER.validate_python(received)


def test_as_many_rows_as_may_be_are_read_and_one_more_is_refused() -> None:
    """The bound is that of the document."""
    assert READER.validate_python([[0.5, 0.5, 0.5]] * MAX_PUSHES).shape == (MAX_PUSHES, 3)
    with pytest.raises(ValidationError):
        READER.validate_python([[0.5, 0.5, 0.5]] * (MAX_PUSHES + 1))


def read_batch(content: bytes) -> BatchRequest:
    """Read a batch as its endpoint does."""
    return validate_body(BatchRequest, parse_json(content))


def test_rows_are_not_changed_by_what_is_asked_of_them() -> None:
    """A request is what was sent, however often its poses are asked for."""
    batch = read_batch(json.dumps({"pushers": [[0.1, 0.2, 7.0]], "object_poses": [[0.1, 0.1, -9.0]]}).encode())
    first = batch.pusher_poses()
    assert (batch.pusher_poses() == first).all()
    assert batch.pushers.tolist() == [[0.1, 0.2, 7.0]]


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"pushers": NaN}', b'{"pushers": [[1e999, 0, 0]]}', b"{}"])
def test_bytes_that_are_no_batch_are_an_error_of_the_tree(content: bytes) -> None:
    """A client gets a problem with the field, whatever it sends."""
    with pytest.raises(CazslError):
        read_batch(content)
