"""Tests of requests and answers: array forms, refused arguments, and unreadable answers."""

import json
import tracemalloc
from typing import Any

import numpy as np
import pytest

from service.client import calls
from service.client.arguments import Context, ScaledDetails
from service.client.errors import ProblemError, UnreadableAnswerError
from service.schemas.contexts import ContextBody
from service.schemas.image_contexts import OutlineContextBody, VisualContextBody
from service.schemas.shapes import OUTLINE_EXAMPLE

PUSHERS = np.array([[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708]])
SEEN = VisualContextBody(visual="AAAA", thumbnail_png="AAAA", flags=[])
FOUND = OutlineContextBody(context=ContextBody(outline=OUTLINE_EXAMPLE), outline_pixels=OUTLINE_EXAMPLE, flags=[])
BATCH = {
    "model": {"name": "push-indicator", "version": 1},
    "frame": "object",
    "mean": [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]],
    "std": [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]],
}


def sent(call: calls.Call[Any]) -> Any:
    """Return the JSON document of a request."""
    return json.loads(call.body["content"])


@pytest.mark.parametrize("array", [PUSHERS, PUSHERS.tolist(), PUSHERS.astype(np.float32), np.asfortranarray(PUSHERS)])
def test_every_form_of_array_is_sent_alike(array: Any) -> None:
    """A list, a float32 array and a Fortran-ordered array are sent as the same numbers."""
    assert sent(calls.predict_batch(array, None, None, None, None)) == {
        "pushers": [pytest.approx(row, abs=1e-6) for row in PUSHERS.tolist()]
    }


@pytest.mark.parametrize(
    ("context", "document"),
    [
        ("1a2b3c4a", {"descriptor": "1a2b3c4a"}),
        (ContextBody(image="AAAA"), {"image": "AAAA"}),
        (SEEN, {"visual": "AAAA"}),
        (ContextBody(outline=OUTLINE_EXAMPLE, friction=0.3), {"outline": OUTLINE_EXAMPLE, "friction": 0.3}),
        (FOUND, {"outline": OUTLINE_EXAMPLE}),
    ],
)
def test_every_form_of_context_is_sent(context: Context, document: dict[str, Any]) -> None:
    """A context in any form is sent for one push, for all pushes, and as one of several with an index."""
    assert sent(calls.predict([0, 0, 0], context, None, None))["context"] == document
    assert sent(calls.predict_batch(PUSHERS, context, None, None, None))["contexts"] == [document]
    several = sent(calls.predict_batch(PUSHERS, [context, context], np.array([1, 0]), None, None))
    assert several["contexts"] == [document, document]
    assert several["context_index"] == [1, 0]


def test_lengths_are_sent_as_one_number_or_one_per_push() -> None:
    """A length goes with its pusher, and lengths are a column. Left out, they are not sent."""
    assert sent(calls.predict([0, 0, 0], None, None, None, 0.02))["pusher"]["length"] == 0.02
    for lengths, found in ((0.02, 0.02), ([0.02, 0.03], [0.02, 0.03]), (np.array([0.02, 0.03]), [0.02, 0.03])):
        assert sent(calls.predict_batch(PUSHERS, None, None, None, None, lengths))["lengths"] == found
    assert "lengths" not in sent(calls.predict_batch(PUSHERS, None, None, None, None))
    for faulty in (np.nan, [[0.02]], "long"):
        with pytest.raises(ProblemError, match=r"lengths: received"):
            calls.predict_batch(PUSHERS, None, None, None, None, faulty)


def test_details_of_an_image_are_fields_of_its_form() -> None:
    """Scale and properties are sent in JSON beside the file, for predictions and for a context."""
    details: ScaledDetails = {
        "metres_per_pixel": 0.0005,
        "centre_of_mass": np.array([0.01, 0.0]),
        "pressure": np.array([1.0, 0.0, 1.0]),
    }
    for call in (calls.predict_image(b"", PUSHERS, None, None, 0.02, details), calls.find_outline(b"", details)):
        assert json.loads(call.body["data"]["metres_per_pixel"]) == 0.0005
        assert json.loads(call.body["data"]["centre_of_mass"]) == [0.01, 0.0]
        assert json.loads(call.body["data"]["pressure"]) == [1.0, 0.0, 1.0]
    with pytest.raises(ProblemError, match=r"friction: received"):
        calls.find_outline(b"", {"metres_per_pixel": 0.0005, "friction": np.nan})


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
def test_invalid_array_is_refused_with_its_field(pushers: Any, where: str) -> None:
    """An array that JSON cannot represent is refused before sending, with the error that the service would give."""
    with pytest.raises(ProblemError) as raised:
        calls.predict_batch(pushers, None, None, None, None)
    assert (raised.value.code, raised.value.status) == ("invalid_request", 422)
    assert [fault.where for fault in raised.value.faults] == [where]


@pytest.mark.parametrize("index", [np.array([0.0, 1.0]), [[0, 1]], "01", [[0], [0, 1]]])
def test_invalid_context_index_is_refused(index: Any) -> None:
    """A context index that is not one integer per push is refused."""
    with pytest.raises(ProblemError, match="context_index"):
        calls.predict_batch(PUSHERS, ["1a2b3c4a"], index, None, None)


def test_text_that_is_not_unicode_is_refused() -> None:
    """Half a character, as a file name that is not UTF-8 gives it, is refused before sending, in JSON and in a form."""
    half = "\ud800"
    for build in (
        lambda: calls.predict([0, 0, 0], half, None, None),
        lambda: calls.predict([0, 0, 0], None, half, None),
        lambda: calls.predict_batch(PUSHERS, half, None, None, None),
        lambda: calls.predict_image(b"", PUSHERS, half, None),
    ):
        with pytest.raises(ProblemError, match="invalid_request"):
            build()


@pytest.mark.parametrize("name", ["", "..", "a/b", "push indicator", "push-indicator?x=1", "é", "Push-indicator"])
def test_invalid_model_name_is_refused(name: str) -> None:
    """A text that is not a model name is refused, because in a path it could name another route."""
    with pytest.raises(ProblemError, match="name"):
        calls.show_model(name)
    with pytest.raises(ProblemError, match="name"):
        calls.show_version(name, 1)


def read(document: object) -> calls.Predictions:
    """Parse an answer for two pushes."""
    return calls.predict_batch(PUSHERS, None, None, None, None).read(200, json.dumps(document).encode(), None)


def test_answer_is_parsed_to_arrays() -> None:
    """An answer becomes float32 arrays in the object's frame, and float64 arrays with covariance in the world frame."""
    predictions = read(BATCH)
    assert predictions.mean.dtype == predictions.std.dtype == np.float32
    assert predictions.mean.tolist() == np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], dtype=np.float32).tolist()
    assert predictions.covariance is None
    in_the_world = read({**BATCH, "frame": "world", "covariance": np.ones((2, 3, 3)).tolist()})
    assert in_the_world.mean.dtype == np.float64
    assert in_the_world.covariance is not None
    assert in_the_world.covariance.shape == (2, 3, 3)


def test_unknown_fields_of_an_answer_are_ignored() -> None:
    """Fields that a later service adds are ignored at every depth, so an old client keeps working."""
    predictions = read({**BATCH, "latency_s": 1.0, "model": {"name": "push-indicator", "version": 1, "digest": "0"}})
    assert predictions.model.version == 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"mean": [[0.1, 0.2, 0.3]]},
        {"mean": [[0.1, 0.2, 0.3]] * 200},
        {"std": [[1.0, 1.0], [2.0, 2.0]]},
        {"mean": [[0.1, 0.2, 0.3], [0.4]]},
        {"mean": None},
        {"frame": "moon"},
        {"mean": [["x", 0, 0], [0, 0, 0]]},
        {"covariance": [[[1.0]]]},
        {"model": {"name": "push-indicator"}},
    ],
)
def test_invalid_answer_is_an_error(wrong: dict[str, Any]) -> None:
    """An answer with missing rows, numbers or names is an UnreadableAnswerError."""
    with pytest.raises(UnreadableAnswerError, match="answer"):
        read({**BATCH, **wrong})


def test_answer_of_many_rows_is_refused_before_it_is_parsed() -> None:
    """More rows than pushes take fifty times their bytes once they are parsed. They are counted before."""
    answer = json.dumps({**BATCH, "mean": [[0, 0, 0]] * 200_000}).encode()
    call = calls.predict_batch(PUSHERS, None, None, None, None)
    tracemalloc.start()
    with pytest.raises(UnreadableAnswerError, match="more rows than the 2 of the request"):
        call.read(200, answer, None)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < len(answer)


def test_warnings_of_an_answer_are_read() -> None:
    """An answer has warnings with codes of later services too, or none of an older service."""
    assert read(BATCH).warnings == ()
    (found,) = read({**BATCH, "warnings": [{"code": "a_later_one", "detail": "why", "rows": [1]}]}).warnings
    assert (found.code, found.detail, found.rows) == ("a_later_one", "why", [1])


@pytest.mark.parametrize("rows", [[2], [-1], ["x"], None, [0] * 2_000_000], ids=["2", "-1", "x", "none", "many"])
def test_a_warning_of_other_rows_is_an_error(rows: Any) -> None:
    """Rows of a warning are rows of the request, at most each once."""
    with pytest.raises(UnreadableAnswerError, match="the answer"):
        read({**BATCH, "warnings": [{"code": "no_contact", "detail": "why", "rows": rows}]})
