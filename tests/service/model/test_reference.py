"""References to models: a name, with an alias or a version."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import InvalidRequestError
from service.model.reference import ModelReference, is_alias, is_name, parse_version


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("push-indicator", ModelReference("push-indicator", "champion", None)),
        ("push-indicator@canary", ModelReference("push-indicator", "canary", None)),
        ("push-indicator@10", ModelReference("push-indicator", None, 10)),
    ],
    ids=["name alone", "alias", "version"],
)
def test_a_reference_is_a_name_with_an_alias_or_a_version(text: str, expected: ModelReference) -> None:
    """A reference is a name, with an alias or a version. A name alone refers to its champion."""
    assert ModelReference.parse(text) == expected
    assert ModelReference.parse(str(expected)) == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "@1",
        "name@",
        "name@0",
        "name@01",
        "name@1@2",
        "../x",
        "a/b",
        "Name",
        "name@-1",
        "n" * 65,
        "name@1.5",
        "a\nb",
    ],
)
def test_an_invalid_reference_is_refused_without_being_repeated(text: str) -> None:
    """Paths, capitals, leading zeros and line ends are refused, and the message gives the length of the text alone."""
    with pytest.raises(InvalidRequestError) as caught:
        ModelReference.parse(text, "body.model")
    assert caught.value.faults[0].where == "body.model"
    assert caught.value.faults[0].received == f"a text of {len(text)} characters"


@given(st.text(max_size=40))
def test_any_text_is_a_reference_or_an_invalid_request(text: str) -> None:
    """Parsing any text gives a reference that parses back to itself, or an error of the tree."""
    try:
        reference = ModelReference.parse(text)
    except InvalidRequestError:
        return
    assert ModelReference.parse(str(reference)) == reference


@pytest.mark.parametrize(
    ("text", "name", "alias", "version"),
    [
        ("champion", True, True, None),
        ("2b", True, True, None),
        ("a" * 64, True, True, None),
        ("7", True, False, 7),
        ("999999999", True, False, 999_999_999),
        ("1000000000", True, False, None),
        ("007", True, False, None),
        ("-a", False, False, None),
        ("Champion", False, False, None),
        ("a" * 65, False, False, None),
        ("٣", False, False, None),
        ("a\n", False, False, None),
    ],
)
def test_the_grammar_parts_names_aliases_and_versions(text: str, name: bool, alias: bool, version: int | None) -> None:
    """An alias is a name that is not a number, and a version is a number of 1 to 9 digits without a leading zero."""
    assert (is_name(text), is_alias(text), parse_version(text)) == (name, alias, version)
