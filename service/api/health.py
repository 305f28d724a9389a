"""The routes of health and metrics."""

from typing import Any, Final

from fastapi import APIRouter, Depends, Request, Response

from service.api.dependencies import may_read_metrics, parts_of, readiness_of, snapshot_of
from service.background.supervision import TaskHealth
from service.observability.prometheus import CONTENT_TYPE
from service.schemas.health import LiveBody, ModelCheckBody, ReadyBody, TaskBody

_NO_MODEL: Final = ReadyBody(
    ready=False,
    reason="not ready, looking again every 2 s, because the registry holds no model",
    checks=[],
    models={},
    problems=[],
    tasks=[],
)
_NOT_READY: Final[dict[str, Any]] = {
    "description": "not ready: the field reason of the body says why",
    "model": ReadyBody,
    "content": {"application/json": {"example": _NO_MODEL.model_dump()}},
}
router = APIRouter(tags=["health"])
metrics_router = APIRouter(dependencies=[Depends(may_read_metrics)], include_in_schema=False)


@router.get("/livez", summary="Liveness of the process")
async def live() -> LiveBody:
    """Return `live`, which is always true."""
    return LiveBody()


@router.get("/readyz", summary="Readiness for predictions", responses={503: _NOT_READY})
async def ready(request: Request, response: Response) -> ReadyBody:
    """Return 200 while the default models answer, else 503 with the `reason`.

    Default models answer pushes that name no model: `push-none`, `push-indicator`, `push-visual`, `push-shape` and
    `push-anp`, unless settings name others. At least one of them has to answer: its alias `champion` serves a version
    whose last self-check was right. So does every other one that has a champion by the record of the registry. One that
    never had a champion, or whose champion was removed, is not waited for. Faults that keep no default model from
    answering, and a file of API keys that cannot be read, are in `problems` and leave the status at 200.
    """
    models, readiness = snapshot_of(request), readiness_of(request)
    reason = readiness.reason()
    response.status_code = 200 if reason is None else 503
    checks = [
        ModelCheckBody(name=check.name, version=check.version, ready=check.ready, reason=check.reason)
        for check in readiness.checks()
    ]
    served = {name: models.versions(name) for name in models.names()}
    return ReadyBody(
        ready=reason is None,
        reason=reason,
        checks=checks,
        models=served,
        problems=[*models.problems, *parts_of(request).keys.problems],
        tasks=[_task(health) for health in parts_of(request).supervisor.health()],
    )


@metrics_router.get("/metrics")
async def metrics(request: Request) -> Response:
    """Return the text of a scrape. It is not part of the API: docs/operations.md lists the metrics."""
    return Response(await parts_of(request).scrapes.text(), media_type=CONTENT_TYPE)


def _task(health: TaskHealth) -> TaskBody:
    return TaskBody(
        name=health.name,
        age_s=round(health.age_s(), 3),
        late=health.is_late(),
        failures=health.failures,
        error=health.error,
    )
