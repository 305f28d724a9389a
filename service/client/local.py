"""The service's answers in this process: the transport of ``Client.local``.

It reads, asks and encodes with the endpoints of ``/v1``, as the HTTP service does, so that answers and problems are the
same to the byte. API keys and limits on time, bytes and concurrent requests protect a service and do not exist here.
"""

import asyncio
import re
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, Self

import httpx2

from service.api.planning.endpoints import PLANNING_ENDPOINTS
from service.api.v1.catalogue import model_body, models_body, version_body
from service.api.v1.endpoints import ENDPOINTS
from service.errors import CazslError, InvalidRequestError, ModelNotReadyError
from service.inference.loaded_models import LoadedModels
from service.inference.snapshot import Snapshot
from service.model.predictor import OnnxPredictor
from service.model.reference import NAME_PATTERN, VERSION_PATTERN
from service.registry.location import open_registry, trusted_keys
from service.transport.callers import LOCAL
from service.transport.endpoints import NO_PARAMETERS, Endpoint, HttpRequest
from service.transport.problems import problem_body

_MODEL: Final = re.compile(rf"/v1/models/(?P<name>{NAME_PATTERN})(?:/versions/(?P<version>{VERSION_PATTERN}))?")
_ENDPOINTS: Final[dict[str, Endpoint[Any]]] = {
    endpoint.path: endpoint for endpoint in (*ENDPOINTS, *PLANNING_ENDPOINTS)
}


class InProcess(httpx2.BaseTransport, httpx2.AsyncBaseTransport):
    """A transport of httpx that answers requests from models in memory."""

    def __init__(self, models: Snapshot) -> None:
        self._models = models

    @classmethod
    def over(cls, registry: str, require_signature: str = "") -> Self:
        """Load the models of a registry as it is now. Each version is verified as in a service.

        Raises:
            RegistryError: the registry cannot be one, or a key cannot be read.
            ModelNotReadyError: no model in it can be used. Names the reasons.
        """
        models = LoadedModels(open_registry(registry, trusted_keys(require_signature)), OnnxPredictor)
        models.refresh()
        if not models.snapshot.models:
            raise ModelNotReadyError(f"no model of {registry} can be used: {'; '.join(models.snapshot.problems)}")
        return cls(models.snapshot)

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        """Answer one request of a blocking client."""
        request.read()
        try:
            return _response(200, self._answer(request))
        except CazslError as error:
            faults = error.faults if isinstance(error, InvalidRequestError) else ()
            return _response(error.status, problem_body(error.status, error.code, error.title, str(error), faults))

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        """Answer one request of an asyncio client, in a thread."""
        await request.aread()
        return await asyncio.to_thread(self.handle_request, request)

    def _answer(self, request: httpx2.Request) -> bytes:
        path = request.url.path
        endpoint = _ENDPOINTS.get(path)
        if endpoint is not None:
            return self._predict(endpoint, request)
        if path == "/v1/models":
            return models_body(self._models).model_dump_json().encode()
        asked = _MODEL.fullmatch(path)
        if asked is None:
            raise CazslError(f"{path} is not answered in process")
        if asked["version"] is None:
            return model_body(self._models, asked["name"]).model_dump_json().encode()
        return version_body(self._models, asked["name"], int(asked["version"])).model_dump_json().encode()

    def _predict(self, endpoint: Endpoint[Any], request: httpx2.Request) -> bytes:
        headers = [(name.lower(), value) for name, value in request.headers.raw]
        asked = HttpRequest(headers, request.content, NO_PARAMETERS, LOCAL)
        if endpoint.is_read_quickly(asked):
            return endpoint.answer(self._models, asked).content
        # A form is parsed in an event loop, and this thread may be running one already, as notebooks do.
        with ThreadPoolExecutor(max_workers=1) as threads:
            return threads.submit(endpoint.answer, self._models, asked).result().content


def _response(status: int, content: bytes) -> httpx2.Response:
    return httpx2.Response(int(status), stream=httpx2.ByteStream(content))
