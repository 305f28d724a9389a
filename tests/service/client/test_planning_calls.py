"""Requests and answers of planning: array forms, refused arguments, and unreadable answers."""

import json
from typing import Any

import numpy as np
import pytest

from service.client import planning_calls
from service.client.calls import Call
from service.client.errors import ProblemError, UnreadableAnswerError
from service.client.planning_calls import Region
from service.schemas.contexts import ContextBody
from service.schemas.shapes import OUTLINE_EXAMPLE

BOX = ContextBody(outline=OUTLINE_EXAMPLE)
PUSHES = np.array([[0.32, 0.1, 0.0, 0.05], [0.4, 0.0, 1.57, 0.02]])
STEP = {
    "mean": {"x": 0.43, "y": 0.1, "angle": 0.1},
    "covariance": [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]],
    "miss_probability": 0.25,
    "inside_probability": 0.0,
    "unfamiliar_probability": 1.0,
}
MODEL = {"name": "push-shape", "version": 1}
MAP = {
    "model": MODEL,
    "frame": "object",
    "pushers": [[0.0, 0.1, 0.2], [0.3, 0.4, 0.5]],
    "points": [[0.0, 0.1], [0.2, 0.3]],
    "length": 0.05,
    "mean": [[0.0] * 3] * 2,
    "std": [[1.0] * 3] * 2,
    "contact": [True, False],
    "effectiveness": [0.9, 0.0],
    "uncertainty": [0.001, 0.002],
    "warnings": [{"code": "no_contact", "detail": "push 1", "rows": [1]}],
}


def sent(call: Call[Any]) -> Any:
    """Return the JSON document of a request."""
    return json.loads(call.body["content"])


def rollout(pushes: Any = PUSHES, **changed: Any) -> Call[planning_calls.Rollout]:
    """Build a request for one sequence."""
    given = {"region": None, "particles": None, "seed": 3, "model": None, "return_particles": False} | changed
    return planning_calls.rollout(pushes, BOX, (0.4, 0.1, 0.0), **given)


def read(call: Call[Any], document: dict[str, Any]) -> Any:
    """Return the answer that a call reads from a document."""
    return call.read(200, json.dumps(document).encode(), None)


def test_a_sequence_is_sent_as_documents_of_pushes() -> None:
    """Rows of four have lengths, and rows of three leave them to the service."""
    document = sent(rollout(region=Region((0.5, 0.1, 0.0), 0.01, 0.2), particles=9))
    assert document["pushes"][1] == {"x": 0.4, "y": 0.0, "angle": 1.57, "length": 0.02}
    assert document["object_pose"] == {"x": 0.4, "y": 0.1, "angle": 0.0}
    assert document["region"] == {
        "x": 0.5, "y": 0.1, "angle": 0.0, "position_tolerance": 0.01, "angle_tolerance": 0.2
    }  # fmt: skip
    assert (document["particles"], document["seed"]) == (9, 3)
    assert "length" not in sent(rollout(PUSHES[:, :3]))["pushes"][0]


@pytest.mark.parametrize("pushes", [[0.0, 0.0, 0.0], [[0.0, 0.0]], [[0.0, 0.0, np.nan]], [["x", "y", "z"]]])
def test_pushes_of_another_form_are_not_sent(pushes: Any) -> None:
    """The problem names the argument."""
    with pytest.raises(ProblemError, match="pushes"):
        rollout(pushes)


def test_steps_are_read_as_arrays() -> None:
    """Means, covariances and probabilities have one row for each push."""
    found = read(rollout(), {"model": MODEL, "frame": "world", "steps": [STEP, STEP], "region_probability": 0.5})
    assert found.steps.mean.shape == (2, 3)
    assert found.steps.covariance[1, 2, 2] == 3.0
    assert found.steps.miss_probability.tolist() == [0.25, 0.25]
    assert found.steps.unfamiliar_probability.tolist() == [1.0, 1.0]
    assert (found.region_probability, found.particles, found.warnings) == (0.5, None, ())


def test_warnings_of_candidates_are_given_to_their_sequences() -> None:
    """The service counts sequences, and each answer has those about it."""
    call = planning_calls.rollouts([PUSHES[:1], PUSHES], BOX, (0.0, 0.0, 0.0), None, None, 0, None)
    warning = {"code": "no_contact", "detail": "sequence 1", "rows": [1]}
    body = {"model": MODEL, "frame": "world", "sequences": [{"steps": [STEP]}, {"steps": [STEP] * 2}]}
    first, second = read(call, body | {"warnings": [warning]})
    assert first.warnings == ()
    assert [found.code for found in second.warnings] == ["no_contact"]
    assert len(second.steps.mean) == 2


@pytest.mark.parametrize(
    "changed",
    [
        {"steps": [STEP]},
        {"steps": [STEP, {**STEP, "covariance": [[1.0]]}]},
        {"steps": [STEP, STEP], "particles": [[[0.0] * 3]]},
        {"steps": [STEP, STEP], "particles": [[[0.0] * 3], [[0.0] * 2]]},
        {"steps": [STEP, STEP], "warnings": [{"code": "x", "detail": "", "rows": [2]}]},
        {},
    ],
)
def test_an_answer_of_another_form_is_unreadable(changed: dict[str, Any]) -> None:
    """An answer with fewer steps, other shapes or rows that were not asked about is not read."""
    with pytest.raises(UnreadableAnswerError):
        read(rollout(), {"model": MODEL, "frame": "world", **changed})


def test_a_map_is_read_as_arrays() -> None:
    """Every column has one row for each push."""
    call = planning_calls.push_map(BOX, 0.01, [-0.2, 0.2], None, "push-shape@1")
    assert sent(call) == {
        "context": {"outline": OUTLINE_EXAMPLE}, "model": "push-shape@1", "spacing": 0.01, "angles": [-0.2, 0.2]
    }  # fmt: skip
    found = read(call, MAP)
    assert (found.pushers.shape, found.points.shape, found.contact.tolist()) == ((2, 3), (2, 2), [True, False])
    assert found.effectiveness.tolist() == [0.9, 0.0]


@pytest.mark.parametrize("name", ["points", "mean", "contact", "uncertainty"])
def test_a_map_with_a_shorter_column_is_unreadable(name: str) -> None:
    """All columns are as long as the pushes."""
    with pytest.raises(UnreadableAnswerError):
        read(planning_calls.push_map(BOX, None, None, None, None), MAP | {name: MAP[name][:1]})  # type: ignore[index]
