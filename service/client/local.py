"""The service's answers without a service: what a client sends is answered here, in this process.

It reads with the same schemas, asks the same functions and writes the same bytes as the HTTP service, problems
included. What guards a service (keys, limits on time, bytes and requests at once) has nothing to guard here.
"""

import asyncio
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, Self, TypeVar

import httpx2
import pydantic_core
from pydantic import ValidationError
from starlette.datastructures import Headers

from service.api.v1.catalogue import model_body, models_body, version_body
from service.api.v1.queries import describe_upload, predict_batch, predict_one, predict_upload
from service.api.v1.uploads import Upload, read_upload
from service.errors import CazslError, MalformedBodyError, ModelNotReadyError
from service.inference.loaded_models import LoadedModels
from service.inference.snapshot import Snapshot
from service.model.predictor import OnnxPredictor
from service.registry.location import open_registry, trusted_keys
from service.schemas.pushes import BatchRequest, PredictRequest
from service.transport.problems import invalid_request, problem_body

P = TypeVar("P", PredictRequest, BatchRequest)
_MODEL: Final = re.compile(r"/v1/models/(?P<name>[A-Za-z0-9_-]+)(?:/versions/(?P<version>[0-9]{1,9}))?")


class InProcess(httpx2.BaseTransport, httpx2.AsyncBaseTransport):
    """A transport of httpx that answers what it is given, from models in memory."""

    def __init__(self, models: Snapshot) -> None:
        self._models = models
        self._doors: dict[str, Callable[[httpx2.Request], bytes]] = {
            "/v1/predict": self._predict,
            "/v1/predict/batch": self._predict_batch,
            "/v1/predict/image": self._predict_image,
            "/v1/contexts": self._make_context,
            "/v1/models": lambda _: models_body(models).model_dump_json().encode(),
        }

    @classmethod
    def over(cls, registry: str, require_signature: str = "") -> Self:
        """Over the models of a registry as it is now; each version is verified as a service would.

        Raises:
            RegistryError: the registry cannot be one, or a key cannot be read.
            ModelNotReadyError: no model in it can be used; says why.
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
            return _problem(error)
        except ValidationError as error:
            found = error.errors(include_url=False)
            return _problem(invalid_request([{**fault, "loc": ("body", *fault["loc"])} for fault in found]))

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        """Answer one request of an asyncio client, in a thread: the loop goes on."""
        await request.aread()
        return await asyncio.to_thread(self.handle_request, request)

    def _answer(self, request: httpx2.Request) -> bytes:
        path = request.url.path
        if path in self._doors:
            return self._doors[path](request)
        asked = _MODEL.fullmatch(path)
        if asked is None:
            raise CazslError(f"{path} is not answered in process")
        if asked["version"] is None:
            return model_body(self._models, asked["name"]).model_dump_json().encode()
        return version_body(self._models, asked["name"], int(asked["version"])).model_dump_json().encode()

    def _predict(self, request: httpx2.Request) -> bytes:
        return predict_one(self._models, _read(PredictRequest, request)).content

    def _predict_batch(self, request: httpx2.Request) -> bytes:
        return predict_batch(self._models, _read(BatchRequest, request)).content

    def _predict_image(self, request: httpx2.Request) -> bytes:
        return predict_upload(self._models, _upload(request)).content

    def _make_context(self, request: httpx2.Request) -> bytes:
        return describe_upload(self._models, _upload(request)).content


def _read(kind: type[P], request: httpx2.Request) -> P:
    try:
        document = pydantic_core.from_json(request.content)
    except ValueError as error:
        raise MalformedBodyError(f"body: received no JSON ({error}); accepted is JSON in UTF-8") from error
    return kind.model_validate(document, from_attributes=True)  # as the web framework asks: the same words for a fault


def _upload(request: httpx2.Request) -> Upload:
    """The form, read in a thread of its own: the caller's may be running a loop, as notebooks do, and it needs one."""
    with ThreadPoolExecutor(max_workers=1) as threads:
        return threads.submit(read_upload, Headers(dict(request.headers)), request.content).result()


def _problem(error: CazslError) -> httpx2.Response:
    faults = getattr(error, "faults", ())
    return _response(error.status, problem_body(error.status, error.code, error.title, str(error), faults))


def _response(status: int, content: bytes) -> httpx2.Response:
    return httpx2.Response(int(status), stream=httpx2.ByteStream(content))
