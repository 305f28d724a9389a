"""The error tree is drawn as it is, and its messages name field, received and accepted value."""

import inspect
import pickle
import re

import pytest

import service.client.errors as client_errors
import service.errors as errors
from service.errors import (
    BodyTooLargeError,
    CazslError,
    ContextKindError,
    FieldFault,
    InvalidRequestError,
    RequestError,
)

TREE = [found for found in vars(errors).values() if isinstance(found, type) and issubclass(found, CazslError)]
CLIENT_TREE = [
    found for found in vars(client_errors).values() if isinstance(found, type) and issubclass(found, CazslError)
]


@pytest.mark.parametrize("error", TREE)
def test_the_docstring_draws_every_error_with_its_status(error: type[CazslError]) -> None:
    """The drawing of the tree has each class with its HTTP status."""
    drawn = re.search(rf"{error.__name__}\b(?P<rest>.*)", errors.__doc__ or "")
    assert drawn is not None
    status = re.search(r"\b\d{3}\b", drawn["rest"])
    if status is not None:
        assert int(status.group()) == error.status


def test_every_error_has_its_own_code() -> None:
    """Programs tell errors apart by their codes, so no two classes share one."""
    codes = [error.code for error in TREE]
    assert len(set(codes)) == len(codes)
    assert all(re.fullmatch(r"[a-z_]+", code) for code in codes)


def test_errors_of_the_request_are_4xx() -> None:
    """Exactly the errors that a client can correct have a status of 4xx."""
    for error in TREE:
        assert (400 <= error.status < 500) == issubclass(error, RequestError), error.__name__


def test_a_message_names_received_and_accepted_values() -> None:
    """Each fault reads as one sentence, and a message has all of them."""
    error = InvalidRequestError([FieldFault("a", "b", "c"), FieldFault("d", "e", "f")])
    assert str(error) == "a: received b; accepted is c; d: received e; accepted is f"
    assert "1024" in str(BodyTooLargeError(1024))


SAMPLES: dict[str, object] = {
    "str": "text",
    "int": 7,
    "float": 2.5,
    "Sequence": [FieldFault("a", "b", "c")],
}


@pytest.mark.parametrize("kind", [*TREE, *CLIENT_TREE])
def test_every_error_survives_a_pickle(kind: type[CazslError]) -> None:
    """An error of a worker process arrives with its class, text and attributes, whatever its constructor takes."""
    own = kind.__init__ is not Exception.__init__
    parameters = [*inspect.signature(kind).parameters.values()] if own else []
    needed = [part for part in parameters if part.default is part.empty]
    error = kind(*(SAMPLES[str(getattr(part.annotation, "__name__", part.annotation))] for part in needed))
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301 (pickled in the same line)
    assert (type(copy), str(copy), vars(copy)) == (kind, str(error), vars(error))


def test_an_invalid_request_is_pickled_with_its_faults() -> None:
    """An error of a worker process arrives with its faults, and not with its text alone."""
    error = ContextKindError.at("body.context", "kind none", "kind visual")
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301 (pickled in the same line)
    assert (type(copy), copy.faults, str(copy)) == (ContextKindError, error.faults, str(error))
