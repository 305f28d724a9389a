"""Routes of planning: documentation of the endpoints."""

from fastapi import APIRouter

from service.api.endpoint_route import EndpointRoute
from service.api.openapi import problems
from service.api.planning.request_examples import AROUND, SEQUENCES
from service.api.v1.routes import PREDICTED
from service.schemas.planning.push_maps import PushMapRequest, PushMapResponse
from service.schemas.planning.rollouts import RolloutRequest, RolloutResponse, RolloutsResponse
from service.schemas.problems import ProblemBody

planning = APIRouter(route_class=EndpointRoute, tags=["plan"], responses=problems(ProblemBody, *PREDICTED))


@planning.post(
    "/v1/rollout",
    summary="Predict sequences of pushes",
    response_model=RolloutResponse | RolloutsResponse,
    openapi_extra=SEQUENCES,
)
async def roll_out(body: RolloutRequest) -> None:
    """Predict the object's pose after each of several `pushes`, or of many candidate `sequences`, in the world.

    Particles follow the pushes, each from its own pose. The answer has their mean and covariance after each push.
    """


@planning.post(
    "/v1/push-map",
    summary="Predict pushes from all around an object",
    response_model=PushMapResponse,
    openapi_extra=AROUND,
)
async def map_pushes(body: PushMapRequest) -> None:
    """Predict pushes from all around the outline of an object, in its frame: made to be drawn.

    Tips start just outside of the outline and head inwards. Places where the tip does not fit are left out.
    """
