"""Rollouts over HTTP: what a sequence of pushes does, by particles, with warnings."""

import math
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.planning.rollout import MOST_ROWS
from service.schemas.shapes import OUTLINE_EXAMPLE
from service.schemas.supports import SUPPORT_EXAMPLE
from tests.service.api.v1.requests import answer, fault, problem

BOX = {"outline": OUTLINE_EXAMPLE}
POSE = {"x": 0.4, "y": 0.1, "angle": 0.5}
PUSH = {"x": 0.31, "y": 0.06, "angle": 0.5, "length": 0.05}


def rolled_out(client: TestClient, **fields: Any) -> Any:
    """Return the rollout of a box, with other fields."""
    return answer(client, "/v1/rollout", {"context": BOX, "object_pose": POSE, **fields})


def test_the_first_step_is_the_prediction_in_the_world(shipped: TestClient) -> None:
    """Mean and covariance of many particles are those of /v1/predict for the same push."""
    found = rolled_out(shipped, pushes=[PUSH], particles=1024)
    plain = answer(shipped, "/v1/predict", {"pusher": PUSH, "context": BOX, "object_pose": POSE})
    (step,) = found["steps"]
    assert (found["frame"], found["model"]) == (plain["frame"], plain["model"])
    std = np.sqrt(np.diagonal(plain["covariance"]))
    assert np.abs(np.array([step["mean"][name] - plain["mean"][name] for name in plain["mean"]]) / std).max() < 0.15
    apart = np.array(step["covariance"]) - np.array(plain["covariance"])
    assert np.abs(apart / np.outer(std, std)).max() < 0.2


def test_the_same_request_has_the_same_answer_and_another_seed_another(shipped: TestClient) -> None:
    """Particles are drawn by the seed alone."""
    first, again, other = (rolled_out(shipped, pushes=[PUSH, PUSH], seed=seed)["steps"] for seed in (0, 0, 5))
    assert first == again
    assert first != other


def test_candidates_are_answered_like_sequences_alone(shipped: TestClient) -> None:
    """Sequences of different lengths come back in their order, each as if it were alone."""
    sequences = [[PUSH, PUSH], [{**PUSH, "angle": 0.3}], [PUSH]]
    found = rolled_out(shipped, sequences=sequences, particles=32)
    assert [len(one["steps"]) for one in found["sequences"]] == [2, 1, 1]
    for sequence, one in zip(sequences, found["sequences"], strict=True):
        alone = rolled_out(shipped, pushes=sequence, particles=32)["steps"]
        for step, expected in zip(one["steps"], alone, strict=True):
            assert list(step["mean"].values()) == pytest.approx(list(expected["mean"].values()), abs=1e-6)


def test_the_probability_of_a_region_is_the_share_of_the_particles(shipped: TestClient) -> None:
    """A region of everything has probability 1, one elsewhere 0, and particles are returned if asked for."""
    wide = {**POSE, "position_tolerance": 1.0, "angle_tolerance": math.pi}
    found = rolled_out(shipped, pushes=[PUSH], region=wide, particles=16, return_particles=True)
    assert found["region_probability"] == 1.0
    assert np.array(found["particles"]).shape == (1, 16, 3)
    assert rolled_out(shipped, pushes=[PUSH], region={**wide, "x": 5.0})["region_probability"] == 0.0


def test_pushes_that_go_wrong_are_told_by_step(shipped: TestClient) -> None:
    """The second push misses the object, and the third comes down in its middle."""
    away, inside = {**PUSH, "y": 0.9}, {**POSE, "length": 0.02}
    found = rolled_out(shipped, pushes=[PUSH, away, inside])
    told = {warning["code"]: warning["rows"] for warning in found["warnings"]}
    assert told["no_contact"] == [1]
    assert told["starts_inside"] == [2]
    assert found["steps"][1]["miss_probability"] == 1.0


def test_an_angle_in_degrees_is_told_about_every_push(shipped: TestClient) -> None:
    """Warnings about the request as a whole have all rows."""
    found = rolled_out(shipped, pushes=[PUSH, {**PUSH, "angle": 90.0}])
    rows = [warning["rows"] for warning in found["warnings"] if warning["code"] == "angle_looks_like_degrees"]
    assert rows == [[0, 1]]


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({}, "body"),
        ({"pushes": [PUSH], "sequences": [[PUSH]]}, "body"),
        ({"pushes": []}, "body.pushes"),
        ({"pushes": [PUSH] * 51}, "body.pushes"),
        ({"sequences": []}, "body.sequences"),
        ({"sequences": [[PUSH] * 50] * 201}, "body.sequences"),
        ({"sequences": [[PUSH] * 50] * 200, "particles": MOST_ROWS // 10_000 + 1}, "body.particles"),
        ({"sequences": [[PUSH] * 50] * 3, "particles": 400, "return_particles": True}, "body.return_particles"),
        ({"pushes": [PUSH, {**PUSH, "x": 20.0}]}, "body.pushes.1"),
        ({"sequences": [[PUSH], [PUSH, {**PUSH, "y": -20.0}]]}, "body.sequences.1.1"),
        ({"pushes": [PUSH, {**PUSH, "length": 0.02}], "context": {"descriptor": "1a2b3c4a"}}, "body.pushes.1.length"),
        ({"pushes": [PUSH], "region": {**POSE, "position_tolerance": 0.0, "angle_tolerance": 1.0}},
         "body.region.position_tolerance"),
    ],
)  # fmt: skip
def test_a_request_that_is_not_valid_is_refused_before_work(
    shipped: TestClient, fields: dict[str, Any], where: str
) -> None:
    """The only fault names its field."""
    response = shipped.post("/v1/rollout", json={"context": BOX, "object_pose": POSE, **fields})
    assert fault(response)[0] == where


def test_a_model_of_another_kind_is_refused(shipped: TestClient) -> None:
    """A model without context is not asked about a box."""
    body = {"context": BOX, "object_pose": POSE, "pushes": [PUSH], "model": "push-none"}
    problem(shipped.post("/v1/rollout", json=body), 422, "wrong_context_kind")


def test_an_object_that_is_known_by_its_pushes_is_rolled_out(shipped: TestClient) -> None:
    """The meta-learner answers for a support: the object is learnt once, and pushes of 50 mm are rolled out."""
    found = rolled_out(shipped, context={"support": SUPPORT_EXAMPLE}, pushes=[PUSH, PUSH], particles=16)
    assert found["model"]["name"] == "push-anp"
    assert len(found["steps"]) == 2
    assert fault(
        shipped.post(
            "/v1/rollout",
            json={
                "context": {"support": SUPPORT_EXAMPLE},
                "object_pose": POSE,
                "pushes": [{**PUSH, "length": 0.1}],
            },
        )
    )[0].startswith("body.pushes")
