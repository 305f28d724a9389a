"""The canonical text, beside what the standard library writes."""

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
    """Something in a record, its fields out of order."""

    name: str
    amounts: list[float]


@dataclass(frozen=True)
class Whole:
    """A record of records."""

    parts: tuple[Part, ...]
    by_name: dict[str, Part]
    last: Part


def written_by_the_library(document: object) -> bytes:
    """The text that was published until now, and stays."""
    text = json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()


@given(DOCUMENTS)
def test_the_text_is_what_the_standard_library_writes(document: Any) -> None:
    """To the byte: empty lists, nested ones, large and small numbers, texts with line ends."""
    assert canonical(document) == written_by_the_library(document)


def test_a_record_is_written_as_its_fields_sorted() -> None:
    """Wherever it stands."""
    part = Part("b", [1e-05, 1e16, -0.0])
    whole = Whole((part, Part("", [])), {"z": part, "a": part}, part)
    assert canonical(whole) == written_by_the_library(asdict(whole))


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("others", [[], [1.0], ["text"]], ids=["alone", "in a row", "beside a text"])
def test_what_is_no_number_has_no_text(number: float, others: list[object]) -> None:
    """JSON has no word for it."""
    with pytest.raises(ValueError, match="not a JSON number"):
        canonical([*others, number])


@pytest.mark.parametrize("document", [{1, 2}, b"bytes", Part], ids=["set", "bytes", "class"])
def test_what_json_cannot_say_is_refused(document: object) -> None:
    """By its type."""
    with pytest.raises(TypeError, match="has no canonical text"):
        canonical(document)
