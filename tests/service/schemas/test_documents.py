"""JSON documents are parsed in bounded time and memory, whatever is in them."""

import json
import tracemalloc
from typing import Any

import numpy as np
import pytest

from service.errors import InvalidRequestError, MalformedBodyError
from service.schemas.body import parse_body
from service.schemas.contexts import INDICATOR_EXAMPLE
from service.schemas.documents import MAX_CONTAINERS, MAX_LONG_NUMBERS, MAX_TEXTS, MAX_VALUES, SHORT_BYTES, parse_json
from service.schemas.pushes import BatchRequest
from service.schemas.rows import MAX_PUSHES

SENT_BYTES = 2 << 20
PEAK_BYTES = 24 << 20  # of Python objects. Each of these documents takes 60 MB and more if it is parsed.

WIDE = {
    "numbers": b"0,",
    "lists": b"[],",
    "objects": b"{},",
    "texts": b'"",',
    "lists of lists": b"[[],[]],",
    "objects with a field": b'{"a":0},',
}


@pytest.mark.parametrize("name", WIDE)
def test_a_wide_document_is_refused_before_it_is_parsed(name: str) -> None:
    """A document of a million small values is refused, and its values take no memory."""
    content = b"[" + WIDE[name] * (SENT_BYTES // len(WIDE[name])) + b"0]"
    tracemalloc.start()
    with pytest.raises(InvalidRequestError, match="body: received more than") as caught:
        parse_json(content)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < PEAK_BYTES
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("unit", [b'{"a":', b"[", b'[{"a":'], ids=["objects", "lists", "both"])
@pytest.mark.parametrize("depth", [1_000, 20_000, 1_000_000])
def test_a_deep_document_is_refused(unit: bytes, depth: int) -> None:
    """A document of a thousand levels and more is refused, without a fault of recursion."""
    with pytest.raises((InvalidRequestError, MalformedBodyError)):
        parse_json(unit * depth)


@pytest.mark.parametrize("digits", [25, 400, 4_000, 1_000_000])
def test_long_numbers_take_a_time_that_is_linear_in_their_digits(digits: int) -> None:
    """Integers beyond 64 bits become floats in a long document, so no long integer is ever computed."""
    content = b"[" + (b"7" * digits + b",") * (SENT_BYTES // digits) + b"0]"
    if digits > 308:
        with pytest.raises(MalformedBodyError, match="infinity"):
            parse_json(content)
    else:
        assert {type(value) for value in parse_json(content)} == {float, int}


@pytest.mark.parametrize("number", [b"NaN", b"1e999", b"-Infinity"])
def test_a_number_that_is_not_finite_is_named_in_a_short_body_and_malformed_in_a_long_one(number: bytes) -> None:
    """The field of such a number is named if the body is short. A long one is no JSON."""
    content = b'{"pushers": [[0, 0, %s]]%s}'
    with pytest.raises(InvalidRequestError) as caught:
        parse_body(BatchRequest, content % (number, b""))
    assert caught.value.faults[0].where == "body.pushers.0.2"
    with pytest.raises(MalformedBodyError):
        parse_body(BatchRequest, content % (number, b" " * SHORT_BYTES))


def test_the_largest_batch_is_within_the_limits() -> None:
    """The largest batch is read: 10,000 pushes with a pose, an index and an indicator each, all forms given."""
    row = [-0.075, 0.0, 0.12345678901234567]
    context = {"descriptor": None, "indicator": INDICATOR_EXAMPLE, "visual": None, "image": None}
    body: dict[str, Any] = {
        "model": "push-indicator@1",
        "pushers": [row] * MAX_PUSHES,
        "contexts": [context] * MAX_PUSHES,
        "context_index": list(range(MAX_PUSHES)),
        "object_poses": [row] * MAX_PUSHES,
    }
    found = parse_body(BatchRequest, json.dumps(body).encode())
    assert found.contexts is not None
    assert len(found.pushers) == len(found.contexts) == MAX_PUSHES


def test_a_document_at_a_limit_is_parsed_and_one_beyond_is_not() -> None:
    """Each limit is the number of things that are still accepted, in a document that is long in bytes."""
    for unit, limit in ((b"[],", MAX_CONTAINERS - 1), (b'"",', MAX_TEXTS), (b"0,", MAX_VALUES)):
        assert len(parse_json(b"[" + unit * limit + b"0]")) == limit + 1
        with pytest.raises(InvalidRequestError):
            parse_json(b"[" + unit * (limit + 1) + b"0]")


@pytest.mark.parametrize("number", [b"2.22507385850720113606e-308", b"22250738585072011361E-327"])
def test_numbers_between_two_floats_are_bounded(number: bytes) -> None:
    """A number of many digits with an exponent takes ten times as long as others. Those that programs write do not."""
    usual = b"-1.2345678901234567e-05,0.00012345678901234567," * MAX_LONG_NUMBERS
    unit, limit = number + b",", MAX_LONG_NUMBERS
    assert len(parse_json(b"[" + usual + unit * limit + b"0]")) == 3 * limit + 1
    with pytest.raises(InvalidRequestError, match="20 digits and more with an exponent"):
        parse_json(b"[" + usual + unit * (limit + 1) + b"0]")


def test_counting_is_as_exact_as_counting_in_python() -> None:
    """What is counted in numpy is what Python counts, at any place of the bytes."""
    content = bytes(np.random.default_rng(0).integers(32, 127, SHORT_BYTES + 1, dtype=np.uint8))
    with pytest.raises((InvalidRequestError, MalformedBodyError)) as caught:
        parse_json(content.replace(b",", b" ") + b"," * (MAX_VALUES + 1))
    assert "500000 values" in str(caught.value)
