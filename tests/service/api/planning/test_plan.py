"""Plans over HTTP: pushes to a goal among obstacles, reasons without a plan, and refused requests."""

from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.schemas.planning.plans import GOAL_EXAMPLE, OBSTACLE_EXAMPLE, WORKSPACE_EXAMPLE
from service.schemas.shapes import OUTLINE_EXAMPLE
from tests.service.api.v1.requests import answer, fault

BOX = {"outline": OUTLINE_EXAMPLE}
TASK = {"context": BOX, "object_pose": {"x": 0.4, "y": 0.1, "angle": 0.0}, "goal": GOAL_EXAMPLE, "time_s": 0.05}


@pytest.fixture(autouse=True)
def stopped_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop the clock of plans, so that a slow machine has the same ones."""
    monkeypatch.setattr("service.api.planning.plan.monotonic", lambda: 0.0)


def planned(client: TestClient, **fields: Any) -> Any:
    """Return the answer to a plan of a box, with other fields."""
    return answer(client, "/v1/plan", {**TASK, **fields})


def test_a_plan_is_confirmed_by_a_rollout(shipped: TestClient) -> None:
    """The pushes lead as far as its steps say, by the same particles, to the goal."""
    found = planned(shipped, position_tolerance=0.03, angle_tolerance=0.5)
    assert found["reason"] is None
    assert found["frame"] == "world"
    assert 0.0 < found["goal_probability"] <= found["replanned_probability"] + 0.3
    again = answer(
        shipped,
        "/v1/rollout",
        {"context": BOX, "object_pose": TASK["object_pose"], "pushes": found["pushes"], "particles": 1024},
    )
    last, expected = found["steps"][-1]["mean"], again["steps"][-1]["mean"]
    assert [last["x"], last["y"]] == pytest.approx([expected["x"], expected["y"]], abs=0.01)
    assert np.hypot(expected["x"] - GOAL_EXAMPLE["x"], expected["y"] - GOAL_EXAMPLE["y"]) < 0.03


def test_the_lengths_are_those_that_were_allowed(shipped: TestClient) -> None:
    """Lengths come in any order, and the plan has no other."""
    found = planned(shipped, lengths=[0.06, 0.03], workspace=WORKSPACE_EXAMPLE, obstacles=[OBSTACLE_EXAMPLE])
    assert {push["length"] for push in found["pushes"]} <= {0.03, 0.06}
    assert all(0.0 <= step["collision_probability"] <= 1.0 for step in found["steps"])


def test_an_object_by_its_descriptor_is_planned_with_its_only_length(shipped: TestClient) -> None:
    """A model of one length gets pushes of 50 mm, and refuses another."""
    goal = {"x": 0.44, "y": 0.1, "angle": 0.0}
    found = planned(shipped, context={"descriptor": "1a2b3c4a"}, goal=goal, position_tolerance=0.02)
    assert found["model"]["name"] == "push-indicator"
    assert {push["length"] for push in found["pushes"]} == {0.05}
    response = shipped.post("/v1/plan", json={**TASK, "context": {"descriptor": "1a2b3c4a"}, "lengths": [0.05, 0.1]})
    assert fault(response)[0] == "body.lengths.1"


def test_a_plan_that_is_not_needed_or_not_possible_is_an_answer(shipped: TestClient) -> None:
    """At the goal there are no pushes and no reason, and a goal outside of the workspace is a reason."""
    there = planned(shipped, goal=TASK["object_pose"])
    assert (there["pushes"], there["steps"], there["goal_probability"], there["reason"]) == ([], [], 1.0, None)
    outside = planned(shipped, workspace=WORKSPACE_EXAMPLE, goal={"x": 0.9, "y": 0.1, "angle": 0.0})
    assert outside["reason"]["code"] == "goal_blocked"
    assert (outside["pushes"], outside["goal_probability"]) == ([], 0.0)


def test_angles_that_look_like_degrees_are_warned_of(shipped: TestClient) -> None:
    """The angle of the goal is judged like those of a push."""
    found = planned(shipped, goal={"x": 0.42, "y": 0.1, "angle": 90.0})
    assert [warning["code"] for warning in found["warnings"]][-1] == "angle_looks_like_degrees"


SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
ROUND = [[float(np.cos(angle)), float(np.sin(angle))] for angle in np.linspace(0.0, 6.0, 60)]


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"context": {"visual": [[0.5] * 32] * 32}}, "body.context"),
        ({"context": None}, "body.context"),
        ({"max_pushes": 0}, "body.max_pushes"),
        ({"max_pushes": 21}, "body.max_pushes"),
        ({"lengths": []}, "body.lengths"),
        ({"lengths": [0.003]}, "body.lengths.0"),
        ({"lengths": [0.05] * 17}, "body.lengths"),
        ({"time_s": 3.0}, "body.time_s"),
        ({"clearance": 0.0}, "body.clearance"),
        ({"position_tolerance": 0.0}, "body.position_tolerance"),
        ({"workspace": [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]}, "body.workspace"),
        ({"workspace": [[0.0, 0.0], [1.0, 0.0]]}, "body.workspace"),
        ({"obstacles": [SQUARE, [[0.0, 0.0], [500.0, 0.0], [0.0, 1.0]]]}, "body.obstacles.1"),
        ({"obstacles": [SQUARE] * 17}, "body.obstacles"),
        ({"obstacles": [ROUND] * 5}, "body.obstacles"),
        ({"goal": {"x": 1e7, "y": 0.0, "angle": 0.0}}, "body.goal.x"),
    ],
)
def test_a_request_that_cannot_be_planned_is_refused(shipped: TestClient, fields: dict[str, Any], where: str) -> None:
    """The fault names its field before any work begins."""
    response = shipped.post("/v1/plan", json={**TASK, **fields})
    assert fault(response)[0] == where
