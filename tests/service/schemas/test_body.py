"""Bodies: strict reading, and errors that name fields without repeating a text that was sent."""

import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import pytest
from pydantic import Field

from service.errors import InvalidRequestError, MalformedBodyError
from service.schemas import body
from service.schemas.body import MAX_FAULTS, Body, at_most, invalid_request, parse_body, validate_body
from service.schemas.documents import parse_json


class Point(Body):
    """A point with a name."""

    x: float
    y: float = 0.0
    name: str | None = None


class Shape(Body):
    """A shape of two to three points."""

    points: Annotated[list[Point], Field(min_length=2, max_length=3)]


class Bits(Body):
    """A list of 36 values."""

    bits: Annotated[list[float], Field(min_length=36, max_length=36), at_most(36)]


class Table(Body):
    """A table with names of the client."""

    cells: dict[str, float]


VALUE = "a value of a client"


def refusal(kind: type[Body], document: Any) -> InvalidRequestError:
    """Return the error of a document, which is the same for bytes and for a document that was parsed before."""
    with pytest.raises(InvalidRequestError) as of_bytes:
        parse_body(kind, json.dumps(document).encode())
    with pytest.raises(InvalidRequestError) as of_document:
        validate_body(kind, parse_json(json.dumps(document).encode()))
    assert of_bytes.value.faults == of_document.value.faults
    return of_bytes.value


def test_a_body_is_read_from_bytes_and_from_a_document() -> None:
    """A body is the same whether its bytes are read in one pass or parsed first."""
    content = b'{"x": 1, "name": "a"}'
    assert parse_body(Point, content) == validate_body(Point, parse_json(content)) == Point(x=1.0, name="a")


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff", b'{"x": 1} {}', b"{'x': 1}", b'{"x": "\\ud800"}', b"[" * 1000, '{"x": 1}'.encode("utf-16")],
    ids=["empty", "cut", "not UTF-8", "two documents", "single quotes", "half a pair", "deep", "UTF-16"],
)
def test_a_body_that_is_no_json_is_malformed(content: bytes) -> None:
    """Bytes that are not one JSON document in UTF-8 are a malformed body, in both ways of reading."""
    for read in (lambda: parse_body(Point, content), lambda: parse_json(content)):
        with pytest.raises(MalformedBodyError, match=r"^body: received no JSON \(.+\); accepted is JSON in UTF-8$"):
            read()


def test_a_document_may_hold_nan_and_a_field_refuses_it() -> None:
    """NaN passes the parser, and is refused with the name of its field."""
    with pytest.raises(InvalidRequestError) as caught:
        validate_body(Point, parse_json(b'{"x": NaN}'))
    (fault,) = caught.value.faults
    assert (fault.where, fault.received) == ("body.x", "a number that is not finite or too large")


@pytest.mark.parametrize(
    ("document", "where", "received", "accepted"),
    [
        ({}, "body.x", "no value", "a value: the field is required"),
        ({"x": "1"}, "body.x", "a text of 1 characters", "a valid number"),
        ({"x": True}, "body.x", "true or false", "a valid number"),
        ({"x": None}, "body.x", "null", "a valid number"),
        ({"x": [1, 2]}, "body.x", "a list of 2 values", "a valid number"),
        ({"x": {"a": 1}}, "body.x", "an object", "a valid number"),
        ({"x": 0.0, "name": 7}, "body.name", "7", "a valid string"),
        ({"x": 0.0, "name": 10**15}, "body.name", "a number that is not finite or too large", "a valid string"),
        ({"x": 0.0, "z": 1}, "body", "the field z", "the fields of the schema only, see /docs"),
        ([], "body", "a list of 0 values", "an object"),
        ("text", "body", "a text of 4 characters", "an object"),
    ],
)
def test_a_fault_names_the_field_the_received_and_the_accepted_value(
    document: Any, where: str, received: str, accepted: str
) -> None:
    """A fault names its field, describes the received value by type and length, and names the accepted values."""
    (fault,) = refusal(Point, document).faults
    assert (fault.where, fault.received, fault.accepted) == (where, received, accepted)


@pytest.mark.parametrize(("count", "accepted"), [(1, "at least 2"), (4, "at most 3")], ids=["too few", "too many"])
def test_a_list_of_another_length_is_refused_with_both_lengths(count: int, accepted: str) -> None:
    """A list with too few or too many values is refused with its length and the nearest accepted one."""
    (fault,) = refusal(Shape, {"points": [{"x": 0.0}] * count}).faults
    assert (fault.where, fault.received, fault.accepted) == ("body.points", f"{count} values", accepted)


def test_a_value_that_is_no_list_is_refused() -> None:
    """A value other than a list is refused where a list is expected."""
    (fault,) = refusal(Shape, {"points": {"0": 1}}).faults
    assert (fault.where, fault.received, fault.accepted) == ("body.points", "an object", "a list")


def test_a_fault_in_a_list_is_named_by_its_place() -> None:
    """A field inside a list is named by its path, with places from 0."""
    (fault,) = refusal(Shape, {"points": [{"x": 0.0}, {"x": "0"}]}).faults
    assert fault.where == "body.points.1.x"


@pytest.mark.parametrize("faults", [1, MAX_FAULTS - 1, MAX_FAULTS, MAX_FAULTS + 1, 1000])
def test_an_error_names_ten_faults_at_most(faults: int) -> None:
    """A body with more faults than ten is refused with the first ten."""
    error = refusal(Point, {"x": 0.0} | {f"field_{number:04}": 0 for number in range(faults)})
    assert [fault.received for fault in error.faults] == [
        f"the field field_{number:04}" for number in range(min(faults, MAX_FAULTS))
    ]


@pytest.mark.parametrize("name", [VALUE, "<script>", "a" * 33, "é", "a.b", ""], ids=repr)
def test_an_unusual_field_name_is_not_repeated(name: str) -> None:
    """A field name other than 1 to 32 letters, digits and underscores is described and never repeated."""
    error = refusal(Point, {"x": 0.0, name: 1})
    assert [fault.received for fault in error.faults] == ["a field with an unusual name"]
    assert not name or name not in str(error)


@pytest.mark.parametrize(
    "document",
    [
        {"x": VALUE},
        {"x": [VALUE]},
        {"x": {VALUE: VALUE}},
        {"x": 0.0, "name": [VALUE]},
        {"x": 0.0, "other": VALUE},
        [VALUE],
        VALUE,
    ],
)
def test_the_value_that_was_sent_is_never_repeated(document: Any) -> None:
    """A text that was sent is in no error, at any place of the body."""
    assert VALUE not in str(refusal(Point, document))


def test_a_prefix_names_the_place_of_the_body() -> None:
    """Paths begin with the prefix, and a fault of the whole body without a prefix is one of the body."""
    with pytest.raises(InvalidRequestError) as caught:
        parse_body(Point, b"{}", prefix=("inputs", "0"))
    assert caught.value.faults[0].where == "inputs.0.x"
    with pytest.raises(InvalidRequestError) as caught:
        parse_body(Point, b"[]", prefix=())
    assert caught.value.faults[0].where == "body"


def test_errors_of_the_framework_become_one_error_of_the_tree() -> None:
    """Errors of pydantic, which carry the input, become faults that do not."""
    found = [{"type": "string_too_long", "loc": ("path", "name"), "msg": "String should be short", "input": VALUE}] * 11
    error = invalid_request(found)
    assert len(error.faults) == MAX_FAULTS
    assert str(error.faults[0]) == "path.name: received a text of 19 characters; accepted is String should be short"


@pytest.mark.parametrize("count", [11, 5_000, 50_000])
def test_unknown_fields_cost_no_more_than_ten(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most ten unknown fields of an object become faults, at any depth, so a thousand cost no more than ten."""
    seen: list[int] = []

    def count_faults(found: Sequence[Mapping[str, Any]], _: tuple[str, ...]) -> InvalidRequestError:
        """Count the faults that pydantic found."""
        seen.append(len(found))
        return InvalidRequestError([])

    monkeypatch.setattr(body, "invalid_request", count_faults)
    unknown = {f"f{number}": 0 for number in range(count)}
    for document in (unknown, {"points": [{"x": 0.0, **unknown}] * 2}, {"points": [{"x": "0", **unknown}] * 3}):
        with pytest.raises(InvalidRequestError):
            parse_body(Shape, json.dumps(document).encode())
    assert max(seen) <= 3 * (len(Point.model_fields) + MAX_FAULTS)


def test_a_list_that_is_too_long_is_refused_before_its_values() -> None:
    """A list of a bounded length has one fault if it is longer, whatever is in it."""
    error = refusal(Bits, {"bits": ["x"] * 10_000})
    assert [(fault.received, fault.accepted) for fault in error.faults] == [("10000 values", "at most 36")]
    assert len(refusal(Bits, {"bits": ["x"] * 36}).faults) == MAX_FAULTS


def test_a_name_in_a_path_is_not_repeated() -> None:
    """The name of an entry that a client chose is in no path of a fault, unless it is short and plain."""
    with pytest.raises(InvalidRequestError) as caught:
        validate_body(Table, {"cells": {"a": 1.0, "<b>" * 9: "x", "n" * 10_000: "x"}})
    unusual = "body.cells.(a field with an unusual name)"
    assert [fault.where for fault in caught.value.faults] == [unusual] * 2
