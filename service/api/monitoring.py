"""``/metrics`` on the service's own port, for those whose key covers it, or on a port of its own."""

from fastapi import APIRouter, Depends, Request, Response
from prometheus_client import CollectorRegistry

from service.api.dependencies import may_read_metrics
from service.observability.prometheus import CONTENT_TYPE, render

router = APIRouter(dependencies=[Depends(may_read_metrics)], include_in_schema=False)


@router.get("/metrics")
async def metrics(request: Request) -> Response:
    """Prometheus's text. No part of the API: its names are in docs/operations.md."""
    collected: CollectorRegistry = request.app.state.metrics
    return Response(render(collected), media_type=CONTENT_TYPE)
