"""Endpoints of planning: answered in a thread, and ended there when the answer is late or no longer wanted."""

import json
from pathlib import Path
from typing import Any

import pytest

from service.api.planning.endpoints import PLANNING_ENDPOINTS
from service.errors import DeadlineError
from service.inference.snapshot import Snapshot
from service.model.tensors import ContextKind
from service.schemas.shapes import OUTLINE_EXAMPLE
from service.transport.endpoints import NO_PARAMETERS, Endpoint, HttpRequest, Weight
from service.turns import TURN
from tests.fakes import fake_models, publish_fake
from tests.late_turn import LateTurn

POSE = {"x": 0.4, "y": 0.1, "angle": 0.0}
PUSH = {"x": 0.3, "y": 0.1, "angle": 0.0, "length": 0.05}
BOX = {"outline": OUTLINE_EXAMPLE}
LONG: dict[str, Any] = {
    "/v1/rollout": {"context": BOX, "object_pose": POSE, "pushes": [PUSH] * 50},
    "/v1/push-map": {"context": BOX, "spacing": 0.0002, "angles": [0.0, 0.1, 0.2, 0.3]},
    "/v1/contexts/refine": {"context": BOX, "pushers": [[-0.1, 0.0, 0.0]] * 50, "outcomes": [[0.02, 0.0, 0.0]] * 50},
}
ENDPOINTS = [endpoint for endpoint in PLANNING_ENDPOINTS if endpoint.path in LONG]


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Snapshot:
    """Return fake models of every kind of context."""
    registry, models = fake_models(Path(tmp_path_factory.mktemp("models")))
    publish_fake(registry, "push-shape", ContextKind.SHAPE)
    models.refresh()
    return models.snapshot


def request(path: str) -> HttpRequest:
    """Return a request that takes long."""
    return HttpRequest([(b"content-type", b"application/json")], json.dumps(LONG[path]).encode(), NO_PARAMETERS)


@pytest.mark.parametrize("endpoint", ENDPOINTS, ids=lambda endpoint: endpoint.path)
def test_a_question_is_never_answered_in_the_event_loop(models: Snapshot, endpoint: Endpoint[Any]) -> None:
    """Neither to read it nor to answer it takes a time that single pushes could wait for."""
    asked = request(endpoint.path)
    assert not endpoint.is_read_quickly(asked)
    assert endpoint.weigh(endpoint.read(asked)) is Weight.HEAVY
    assert endpoint.answer(models, asked).pushes > 1


@pytest.mark.parametrize("endpoint", ENDPOINTS, ids=lambda endpoint: endpoint.path)
def test_a_question_ends_at_the_pause_where_its_answer_is_late(models: Snapshot, endpoint: Endpoint[Any]) -> None:
    """The work stops in the middle, at whichever pause the deadline strikes or the client has left."""
    for pauses in (0, 1, 2):
        token = TURN.set(LateTurn(pauses))
        try:
            with pytest.raises(DeadlineError):
                endpoint.answer(models, request(endpoint.path))
        finally:
            TURN.reset(token)
