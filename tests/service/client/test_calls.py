"""Arrays to requests, answers to arrays: what cannot be sent, and what is no answer."""

import json
from typing import Any

import numpy as np
import pytest

from service.client import calls
from service.client.errors import ProblemError, UnreadableAnswerError
from service.schemas.contexts import ContextBody, VisualContextBody

PUSHERS = np.array([[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708]])
SEEN = VisualContextBody(visual="AAAA", thumbnail_png="AAAA", flags=[])
BATCH = {
    "model": {"name": "push-indicator", "version": 1},
    "frame": "object",
    "mean": [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]],
    "std": [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]],
}


def sent(call: calls.Call[Any]) -> Any:
    """The document of a request."""
    return json.loads(call.body["content"])


@pytest.mark.parametrize("array", [PUSHERS, PUSHERS.tolist(), PUSHERS.astype(np.float32), np.asfortranarray(PUSHERS)])
def test_pushers_are_sent_whatever_form_of_array_they_have(array: Any) -> None:
    """Lists, float32, columns first: the numbers arrive."""
    assert sent(calls.predict_batch(array, None, None, None, None)) == {
        "pushers": [pytest.approx(row, abs=1e-6) for row in PUSHERS.tolist()]
    }


@pytest.mark.parametrize(
    ("context", "document"),
    [
        ("1a2b3c4a", {"descriptor": "1a2b3c4a"}),
        (ContextBody(image="AAAA"), {"image": "AAAA"}),
        (SEEN, {"visual": "AAAA"}),
    ],
)
def test_an_object_is_told_in_any_form(context: calls.Context, document: dict[str, str]) -> None:
    """Alone for all pushes, and as one of several."""
    assert sent(calls.predict([0, 0, 0], context, None, None))["context"] == document
    assert sent(calls.predict_batch(PUSHERS, context, None, None, None))["contexts"] == [document]
    several = sent(calls.predict_batch(PUSHERS, [context, context], np.array([1, 0]), None, None))
    assert several["contexts"] == [document, document]
    assert several["context_index"] == [1, 0]


@pytest.mark.parametrize(
    ("pushers", "where"),
    [
        (np.zeros((2, 4)), "pushers"),
        (np.zeros(3), "pushers"),
        (0.0, "pushers"),
        ("1a2b3c4a", "pushers"),
        ([[0.0, 0.0, 0.0], [0.0]], "pushers"),
        (np.array([[0, 0, 1j]]), "pushers"),
        ([[0.0, np.nan, 0.0]], "pushers.0.1"),
        ([[0.0, 0.0, 0.0], [0.0, 0.0, np.inf]], "pushers.1.2"),
    ],
)
def test_what_json_cannot_carry_is_refused_with_its_place(pushers: Any, where: str) -> None:
    """As the service would, before anything is sent."""
    with pytest.raises(ProblemError) as raised:
        calls.predict_batch(pushers, None, None, None, None)
    assert (raised.value.code, raised.value.status) == ("invalid_request", 422)
    assert [fault.where for fault in raised.value.faults] == [where]


@pytest.mark.parametrize("index", [np.array([0.0, 1.0]), [[0, 1]], "01"])
def test_an_index_that_is_none_is_refused(index: Any) -> None:
    """One integer per push."""
    with pytest.raises(ProblemError, match="context_index"):
        calls.predict_batch(PUSHERS, ["1a2b3c4a"], index, None, None)


@pytest.mark.parametrize("name", ["", "..", "a/b", "push indicator", "push-indicator?x=1", "é"])
def test_a_name_that_would_ask_for_another_route_is_refused(name: str) -> None:
    """A name is one part of a path."""
    with pytest.raises(ProblemError, match="name"):
        calls.show_model(name)
    with pytest.raises(ProblemError, match="name"):
        calls.show_version(name, 1)


def read(document: object) -> calls.Predictions:
    """Two pushes' answer."""
    return calls.predict_batch(PUSHERS, None, None, None, None).read(200, json.dumps(document).encode(), None)


def test_an_answer_becomes_arrays() -> None:
    """float32 in the object's frame, as the model gave them."""
    predictions = read(BATCH)
    assert predictions.mean.dtype == predictions.std.dtype == np.float32
    assert predictions.mean.tolist() == np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], dtype=np.float32).tolist()
    assert predictions.covariance is None
    in_the_world = read({**BATCH, "frame": "world", "covariance": np.ones((2, 3, 3)).tolist()})
    assert in_the_world.mean.dtype == np.float64
    assert in_the_world.covariance is not None
    assert in_the_world.covariance.shape == (2, 3, 3)


def test_fields_that_a_later_service_adds_are_left_alone() -> None:
    """At every depth: an old client goes on working."""
    predictions = read({**BATCH, "latency_s": 1.0, "model": {"name": "push-indicator", "version": 1, "digest": "0"}})
    assert predictions.model.version == 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"mean": [[0.1, 0.2, 0.3]]},
        {"std": [[1.0, 1.0], [2.0, 2.0]]},
        {"mean": [[0.1, 0.2, 0.3], [0.4]]},
        {"mean": None},
        {"frame": "moon"},
        {"mean": [["x", 0, 0], [0, 0, 0]]},
        {"covariance": [[[1.0]]]},
        {"model": {"name": "push-indicator"}},
    ],
)
def test_an_answer_that_is_none_says_what_is_wrong(wrong: dict[str, Any]) -> None:
    """Rows missing, numbers missing, names missing."""
    with pytest.raises(UnreadableAnswerError, match="answer"):
        read({**BATCH, **wrong})
