"""Requests and answers of plans and refinements: array forms, refused arguments, and unreadable answers."""

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.client import AsyncClient, Client, plan_calls
from service.client.calls import Call
from service.client.errors import ProblemError, UnreadableAnswerError
from service.client.plan_calls import Plan, Refinement
from service.schemas.contexts import ContextBody
from service.schemas.shapes import OUTLINE_EXAMPLE
from tests.service.client.test_planning_calls import MODEL, STEP

BOX = ContextBody(outline=OUTLINE_EXAMPLE)
PUSHERS = np.array([[-0.08, 0.02, 0.0], [0.02, -0.06, 1.5708], [0.08, 0.01, 3.14159], [0.03, 0.06, -1.5708]])
TRIANGLE = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
ANSWER = {
    "model": MODEL,
    "frame": "world",
    "pushes": [{"x": 0.3, "y": 0.1, "angle": 0.2, "length": 0.05}],
    "steps": [{**STEP, "collision_probability": 0.5}],
    "goal_probability": 0.25,
    "replanned_probability": 0.75,
    "reason": None,
    "stopped": False,
    "warnings": [{"code": "no_contact", "detail": "push 0", "rows": [0]}],
}
NO_PLAN = ANSWER | {
    "pushes": [], "steps": [], "warnings": [], "goal_probability": 0.0, "replanned_probability": 0.0, "stopped": True,
    "reason": {"code": "out_of_reach", "detail": "32 mm off"},
}  # fmt: skip


def asked(**changed: Any) -> Call[Plan]:
    """Build a request."""
    given: dict[str, Any] = {
        "object_pose": (0.4, 0.1, 0.0), "goal": np.array([0.5, 0.1, 1.0]), "position_tolerance": 0.01,
        "angle_tolerance": 0.2, "max_pushes": 3, "lengths": None, "workspace": None, "obstacles": (),
        "clearance": None, "time_s": None, "seed": 2, "model": None,
    } | changed  # fmt: skip
    return plan_calls.plan(BOX, **given)


def read(document: dict[str, Any]) -> Plan:
    """Return the answer that a call reads from a document."""
    return asked().read(200, json.dumps(document).encode(), None)


def test_arrays_are_sent_as_lists_and_what_is_not_given_is_left_out() -> None:
    """Polygons are rows of corners, one length is a list of one, and defaults are those of the service."""
    document = json.loads(asked(lengths=0.05, workspace=TRIANGLE * 9.0, obstacles=[TRIANGLE]).body["content"])
    assert document["obstacles"] == [TRIANGLE.tolist()]
    assert document["workspace"][1] == [0.9, 0.0]
    assert document["lengths"] == [0.05]
    assert document["goal"] == {"x": 0.5, "y": 0.1, "angle": 1.0}
    assert not {"clearance", "time_s", "model"} & document.keys()
    timed = json.loads(asked(time_s=0.5, clearance=0.01, model="push-shape").body["content"])
    assert (timed["time_s"], timed["clearance"], timed["model"]) == (0.5, 0.01, "push-shape")


@pytest.mark.parametrize(
    "changed", [{"goal": (0.0, 0.0)}, {"workspace": [[0.0, np.nan]]}, {"obstacles": [["a"]]}, {"lengths": "long"}]
)
def test_arguments_of_another_form_are_not_sent(changed: dict[str, Any]) -> None:
    """A goal without an angle, and numbers that are none, are refused here."""
    with pytest.raises(ProblemError):
        asked(**changed)


def test_an_answer_becomes_arrays() -> None:
    """Pushes are rows of four, with the steps after them."""
    found = read(ANSWER)
    assert found.pushes.tolist() == [[0.3, 0.1, 0.2, 0.05]]
    assert found.steps.mean.shape == (1, 3)
    assert found.collision_probability.tolist() == [0.5]
    assert (found.goal_probability, found.replanned_probability, found.reason) == (0.25, 0.75, None)
    assert found.warnings[0].rows == [0]


def test_an_answer_without_a_plan_has_empty_arrays_and_its_reason() -> None:
    """Code and words of the reason are given."""
    found = read(NO_PLAN)
    assert found.pushes.shape == (0, 4)
    assert found.steps.covariance.shape == (0, 3, 3)
    assert found.reason is not None
    assert (found.reason.code, found.stopped) == ("out_of_reach", True)


@pytest.mark.parametrize("changed", [{"steps": []}, {"pushes": []}, {"warnings": [ANSWER["warnings"][0] | {"rows": [7]}]}])  # type: ignore[index] # fmt: skip # noqa: E501
def test_an_answer_that_contradicts_itself_is_unreadable(changed: dict[str, Any]) -> None:
    """Every push has one step, and warnings are about pushes that there are."""
    with pytest.raises(UnreadableAnswerError):
        read(ANSWER | changed)


def test_a_refined_context_is_taken_by_other_calls(project_root: Path) -> None:
    """Both clients give the same context, and a prediction with it is nearer to the outcomes than before."""
    registry = str(project_root / "models")
    with Client.local(registry) as client:
        loaded = ContextBody(outline=OUTLINE_EXAMPLE, centre_of_mass=[0.03, 0.0])
        outcomes = client.predict_batch(PUSHERS, loaded).mean
        found = client.refine(BOX, PUSHERS, outcomes)
        assert (found.outliers, found.warnings) == ((), ())
        before, after = (
            np.abs(client.predict_batch(PUSHERS, context).mean - outcomes).mean() for context in (BOX, found.context)
        )
        assert after < 0.7 * before

        async def ask() -> Refinement:
            """Ask the same with asyncio."""
            async with AsyncClient.local(registry) as other:
                return await other.refine(BOX, PUSHERS, outcomes)

        assert asyncio.run(ask()).context == found.context


@pytest.mark.parametrize("outcomes", [[0.0, 0.0, 0.0], [[0.0, 0.0]], [[np.nan, 0.0, 0.0]]])
def test_outcomes_of_another_form_are_refused_at_once(outcomes: object) -> None:
    """Arrays of another shape, and numbers that are none, are refused before anything is sent."""
    with pytest.raises(ProblemError, match="outcomes"):
        plan_calls.refine(BOX, PUSHERS[:1], outcomes, None, None, 0, None)  # type: ignore[arg-type]


def test_an_answer_about_other_pushes_is_none() -> None:
    """Outliers that are none of the rows that were sent are refused."""
    call = plan_calls.refine(BOX, PUSHERS, PUSHERS, 0.05, [[0.0, 0.0, 0.0]], 3, "push-shape")
    sent = json.loads(call.body["content"])
    assert (sent["seed"], sent["model"], sent["lengths"], len(sent["object_poses"])) == (3, "push-shape", 0.05, 1)
    answer = {
        "model": {"name": "push-shape", "version": 1},
        "frame": "object",
        "context": {"outline": OUTLINE_EXAMPLE},
        "outliers": [4],
        "warnings": [],
    }
    with pytest.raises(UnreadableAnswerError, match="outliers"):
        call.read(200, json.dumps(answer).encode(), None)
