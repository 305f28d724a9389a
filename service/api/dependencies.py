"""Dependencies of routes: the parts of the application that they use, and the keys that they require."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from prometheus_client import CollectorRegistry

from service.api.scrapes import Scrapes
from service.background.supervision import Supervisor
from service.errors import MissingKeyError
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.inference.snapshot import Snapshot
from service.transport.callers import needed_scope
from service.transport.endpoints import Endpoints
from service.transport.keys import Keys, Scope

_bearer = HTTPBearer(auto_error=False, description="an API key; `cazsl keys new` makes one")


@dataclass(frozen=True)
class Parts:
    """Parts of the application that its routes use. The application holds them as ``parts``."""

    models: LoadedModels
    readiness: Readiness
    supervisor: Supervisor
    keys: Keys
    endpoints: Endpoints
    metrics: CollectorRegistry
    scrapes: Scrapes


def parts_of(request: Request) -> Parts:
    """Return the parts of the application that answers a request."""
    parts: Parts = request.app.parts
    return parts


def snapshot_of(request: Request) -> Snapshot:
    """Return the models that are served now. A request uses one snapshot throughout."""
    return parts_of(request).models.snapshot


def readiness_of(request: Request) -> Readiness:
    """Return the readiness of all loaded versions."""
    return parts_of(request).readiness


async def may_read_metrics(request: Request) -> None:
    """Require a key with the scope of metrics, as a dependency.

    Raises:
        MissingKeyError, ForbiddenError: the request has no such key.
    """
    _admit(request, Scope.METRICS)


async def may_predict(
    request: Request, _: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)] = None
) -> None:
    """Require a key with the scope of predictions, as a dependency.

    Raises:
        MissingKeyError, ForbiddenError: the request has no such key.
    """
    _admit(request, Scope.PREDICT)


def _admit(request: Request, scope: Scope) -> None:
    """Trust the key that admission has checked at the head, if it did so for this scope."""
    if parts_of(request).keys.wanted and needed_scope(request.scope["path"]) is not scope:
        raise MissingKeyError
