"""Routes of planning: documentation of the endpoints."""

from fastapi import APIRouter

from service.api.endpoint_route import EndpointRoute
from service.api.openapi import problems
from service.api.planning.request_examples import AROUND, GOALS, KNOWN_PUSHES, SEQUENCES
from service.api.v1.routes import PREDICTED
from service.schemas.planning.plans import PlanRequest, PlanResponse
from service.schemas.planning.push_maps import PushMapRequest, PushMapResponse
from service.schemas.planning.refinements import RefineRequest, RefineResponse
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


@planning.post(
    "/v1/plan",
    summary="Plan pushes to a goal",
    response_model=PlanResponse,
    openapi_extra=GOALS,
)
async def plan_pushes(body: PlanRequest) -> None:
    """Plan pushes that bring an object of known outline from a pose to a goal, in the world, or say why there are none.

    Neither object nor tip touches an obstacle or leaves the workspace, by predicted means. The tip comes down from
    above where a push starts, clear of the object, and is lifted at its end, so ways between pushes are not checked.
    Make the first push, look where the object is, and ask again.
    """


@planning.post(
    "/v1/contexts/refine",
    summary="Learn the body of an object from a few pushes",
    response_model=RefineResponse,
    openapi_extra=KNOWN_PUSHES,
)
async def refine_context(body: RefineRequest) -> None:
    """Return the context of an object with the centre of mass, friction and pressure that 1 to 50 pushes tell.

    Send it as the context of further requests. Its `posterior` says how sure the values are. Nothing is stored.
    """
