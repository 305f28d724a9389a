"""Endpoints of planning: how their requests are checked and read. Each is answered in a thread, in turns."""

from collections.abc import Callable
from typing import Any, Final, TypeVar

from service.api.planning.plan import answer_plan
from service.api.planning.push_map import answer_push_map
from service.api.planning.refine import answer_refine
from service.api.planning.rollout import answer_rollout
from service.api.v1.endpoints import check_json
from service.inference.query import Answer
from service.inference.snapshot import Snapshot
from service.schemas.body import Body, parse_body
from service.schemas.planning.plans import PlanRequest
from service.schemas.planning.push_maps import PushMapRequest
from service.schemas.planning.refinements import RefineRequest
from service.schemas.planning.rollouts import RolloutRequest
from service.transport.endpoints import Endpoint, Weight

B = TypeVar("B", bound=Body)


def _endpoint(path: str, kind: type[B], answer: Callable[[Snapshot, B], Answer]) -> Endpoint[B]:
    return Endpoint(
        path,
        check=check_json,
        read=lambda request: parse_body(kind, request.content),
        ask=answer,
        weigh=lambda _: Weight.HEAVY,
        is_read_quickly=lambda _: False,
    )


PLANNING_ENDPOINTS: Final[tuple[Endpoint[Any], ...]] = (
    _endpoint("/v1/rollout", RolloutRequest, answer_rollout),
    _endpoint("/v1/push-map", PushMapRequest, answer_push_map),
    _endpoint("/v1/plan", PlanRequest, answer_plan),
    _endpoint("/v1/contexts/refine", RefineRequest, answer_refine),
)
