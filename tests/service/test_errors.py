"""The error tree."""

import re

import pytest

import service.errors as errors
from service.errors import BodyTooLargeError, CazslError, FieldFault, InvalidRequestError, RequestError

TREE = [found for found in vars(errors).values() if isinstance(found, type) and issubclass(found, CazslError)]


@pytest.mark.parametrize("error", TREE)
def test_every_error_stands_in_the_drawing_with_its_status(error: type[CazslError]) -> None:
    """The module's docstring draws the tree as it is."""
    drawn = re.search(rf"{error.__name__}\b(?P<rest>.*)", errors.__doc__ or "")
    assert drawn is not None
    status = re.search(r"\b\d{3}\b", drawn["rest"])
    if status is not None:
        assert int(status.group()) == error.status


def test_every_code_is_stable_and_its_own() -> None:
    """Programs tell errors apart by their code."""
    codes = [error.code for error in TREE]
    assert len(set(codes)) == len(codes)
    assert all(re.fullmatch(r"[a-z_]+", code) for code in codes)


def test_what_the_caller_can_mend_is_a_4xx_and_nothing_else_is() -> None:
    """The status says whose fault it is."""
    for error in TREE:
        assert (400 <= error.status < 500) == issubclass(error, RequestError), error.__name__


def test_messages_say_what_was_received_and_what_is_accepted() -> None:
    """Each fault reads as one sentence, and all of them are there."""
    error = InvalidRequestError([FieldFault("a", "b", "c"), FieldFault("d", "e", "f")])
    assert str(error) == "a: received b; accepted is c; d: received e; accepted is f"
    assert "1024" in str(BodyTooLargeError(1024))
