"""The health routes."""

from typing import Any, Final

from fastapi import APIRouter, Request, Response

from service.api.dependencies import readiness_of, snapshot_of
from service.schemas.health import LiveBody, ModelCheckBody, ReadyBody

_NOTHING_YET: Final = ReadyBody(
    ready=False,
    reason="not ready, looking again every 2 s, because the registry holds no model",
    checks=[],
    models={},
    problems=[],
)
_NOT_READY: Final[dict[str, Any]] = {
    "description": "not now; the body says why",
    "model": ReadyBody,
    "content": {"application/json": {"example": _NOTHING_YET.model_dump()}},
}
router = APIRouter()


@router.get("/livez", tags=["health"], summary="Does the process answer?")
async def live() -> LiveBody:
    """Always true: who can read it knows."""
    return LiveBody()


@router.get(
    "/readyz",
    tags=["health"],
    summary="Can predictions be answered?",
    responses={503: _NOT_READY},
)
async def ready(request: Request, response: Response) -> ReadyBody:
    """Ready while a model that passed all its checks answers; a broken newcomer is named here and does not end it."""
    models, readiness = snapshot_of(request), readiness_of(request)
    reason = readiness.reason()
    response.status_code = 200 if reason is None else 503
    checks = [
        ModelCheckBody(name=check.name, version=check.version, ready=check.ready, reason=check.reason)
        for check in readiness.checks()
    ]
    names = sorted({name for name, _ in models.models})
    served = {name: models.versions(name) for name in names}
    return ReadyBody(ready=reason is None, reason=reason, checks=checks, models=served, problems=list(models.problems))
