"""The strict reader: ordinary documents as the standard library reads them, ugly ones refused by their rule."""

import json
from typing import Any

import orjson
import pytest

from service.model.strict_json import LARGEST, MAX_DEPTH, MAX_NAMES, MAX_TEXT, check_integer, check_text, read_json

LIMIT = 1 << 20


@pytest.mark.parametrize(
    "document",
    [
        None,
        0,
        -LARGEST,
        LARGEST,
        1.5,
        1e308,
        5e-324,
        "",
        "Ünïcödé \U0001f600",
        "\n",
        [],
        {},
        [[], {"a": [1, {"b": None}]}, True],
        {"\u2028": "\u0000"},
    ],
)
@pytest.mark.parametrize("ascii_only", [True, False])
def test_an_ordinary_document_is_read_as_the_standard_library_reads_it(document: Any, ascii_only: bool) -> None:
    """A document without faults is read unchanged, with escapes or without, and another reader reads it too."""
    content = json.dumps(document, ensure_ascii=ascii_only).encode()
    assert read_json(content, LIMIT) == document
    assert orjson.loads(content) == document


DEEP = MAX_DEPTH + 2
UGLY: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "not a JSON document"),
    "two documents": (b"{}{}", "not a JSON document"),
    "trailing comma": (b"[1,]", "not a JSON document"),
    "comment": (b"{} // note", "not a JSON document"),
    "Latin-1": ('"ä"'.encode("latin-1"), "not a JSON document"),
    "UTF-16": ('{"a": 1}'.encode("utf-16"), "not a JSON document"),
    "byte order mark": (b"\xef\xbb\xbf{}", "not a JSON document"),
    "half a character in bytes": (b'"\xed\xa0\x80"', "not a JSON document"),
    "half a character as an escape": (rb'"\ud800"', "half a character"),
    "the other half": (rb'"\udC00"', "half a character"),
    "two first halves": (rb'"\ud83d\ud83d"', "half a character"),
    "half a character in a name": (rb'{"\udfff": 1}', "half a character"),
    "half a character deep inside": (rb'[[{"a": ["\uD8ff"]}]]', "half a character"),
    "NaN": (b'{"a": NaN}', "NaN or Infinity"),
    "Infinity": (b"[-Infinity]", "NaN or Infinity"),
    "a fraction that overflows": (b"1e999", "too large"),
    "a negative one": (b'{"a": [-1.5e309]}', "too large"),
    "an integer past 64 bits": (b"9223372036854775808", "too large"),
    "an integer of a million digits": (b"1" * 1_000_000, "too large"),
    "a name twice": (b'{"a": 1, "a": 1}', "occurs twice"),
    "a name twice by an escape": (rb'{"a": 1, "\u0061": 2}', "occurs twice"),
    "too many names": (json.dumps(dict.fromkeys(map(str, range(MAX_NAMES + 1)))).encode(), "names"),
    "deep lists": (b"[" * DEEP + b"]" * DEEP, "nested deeper"),
    "deep objects": (b'{"a":' * DEEP + b"0" + b"}" * DEEP, "nested deeper"),
    "very deep": (b"[" * 500_000, "nested deeper"),
    "a control character": (b'"\x01"', "not a JSON document"),
    "too many bytes": (b" " * LIMIT + b"1", "bytes"),
}


@pytest.mark.parametrize("case", UGLY)
def test_an_ugly_document_is_refused_by_its_rule(case: str) -> None:
    """A document that another reader would refuse, change or choke on raises ``ValueError`` with the rule."""
    content, rule = UGLY[case]
    with pytest.raises(ValueError, match=rule):
        read_json(content, LIMIT)


@pytest.mark.parametrize("text", ["", "Robot 7", "größer", "a\u00a0b", "\U0001f469\u200d\U0001f680", "x" * MAX_TEXT])
def test_a_short_text_is_returned(text: str) -> None:
    """A line of any language is a short text, with wide spaces and joined pictures too."""
    assert check_text(text) == text


@pytest.mark.parametrize(
    "text", ["\n", "a\tb", "\x00", "\x1b[31mred", "\x7f", "\x9b1m", "\u2028", "\u2029", "\u202egnp", "\ud800", "\u2066"]
)
def test_a_text_with_control_characters_is_refused(text: str) -> None:
    """Controls, half characters and marks that turn the direction of writing are in no short text."""
    with pytest.raises(ValueError, match="control characters"):
        check_text(text)


def test_a_long_text_is_refused() -> None:
    """The limit of a short text is that of its field."""
    with pytest.raises(ValueError, match="at most 3"):
        check_text("four", 3)


@pytest.mark.parametrize("value", [True, 1.0, "1", None, -1, LARGEST + 1, 10**400])
def test_only_an_integer_within_bounds_is_one(value: object) -> None:
    """A boolean, a fraction, a text and a number out of bounds are refused."""
    with pytest.raises(ValueError, match="not an integer"):
        check_integer(value)
    assert check_integer(5, 1, 9) == 5
