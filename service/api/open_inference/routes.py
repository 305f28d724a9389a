"""The routes of the Open Inference Protocol, over the same models as ``/v1``, for clients that speak it already.

Names, fields and statuses are the protocol's (Open Inference Protocol V2, REST). Where servers differ, the answer is one
that every known client reads: both ``live`` and ``ready`` in health, ``model_name`` in every inference, versions as texts,
errors as ``{"error": text}`` in plain ``application/json``.
"""

import base64
from typing import Annotated, Any, Final

import numpy as np
from fastapi import APIRouter, Path, Request
from pydantic.config import JsonDict

import service
from service.api.dependencies import readiness_of, snapshot_of
from service.api.endpoint_route import EndpointRoute
from service.api.open_inference.bodies import (
    INFERENCE,
    ErrorBody,
    InferRequestBody,
    InferResponseBody,
    ModelMetadataBody,
    ModelReadyBody,
    ServerBody,
    ServerLiveBody,
    ServerReadyBody,
    TensorBody,
)
from service.api.open_inference.endpoints import MODEL_PATH, VERSION_PATH
from service.api.open_inference.queries import parse_reference
from service.api.open_inference.wire import DATATYPES, render
from service.api.openapi import protocol_errors
from service.errors import (
    BodyTooLargeError,
    CazslError,
    DeadlineError,
    InvalidRequestError,
    MalformedBodyError,
    ModelNotReadyError,
    OverloadedError,
    PredictionError,
    SlowBodyError,
    TooManyRequestsError,
    UnknownModelError,
    UnsupportedMediaTypeError,
)
from service.model.reference import ALIAS_PATTERN, NAME_PATTERN, VERSION_PATTERN
from service.model.tensors import Tensor

# For the document only: ``ModelReference`` has the better error messages.
_NAME: Final[JsonDict] = {"pattern": f"^{NAME_PATTERN}(@{ALIAS_PATTERN})?$"}
_VERSION: Final[JsonDict] = {"pattern": f"^{VERSION_PATTERN}$"}
Name = Annotated[str, Path(description="a model, or model@alias", examples=["push-indicator"], json_schema_extra=_NAME)]
Version = Annotated[str, Path(description="version of the model", examples=["1"], json_schema_extra=_VERSION)]
_AT_ONCE: Final = (TooManyRequestsError, OverloadedError)  # whatever is asked for
_NAMED: Final = (InvalidRequestError, UnknownModelError, *_AT_ONCE)
_INFERRED: Final = (
    MalformedBodyError,
    SlowBodyError,
    BodyTooLargeError,
    UnsupportedMediaTypeError,
    PredictionError,
    CazslError,
    ModelNotReadyError,
    DeadlineError,
    *_NAMED,
)
_INFER_BODY: Final = {
    "requestBody": {
        "required": True,
        "description": "JSON; or, with the header Inference-Header-Content-Length, that many bytes of JSON and behind "
        "them the tensors that have a binary_data_size, little-endian, in the order of the JSON. May come compressed, "
        "as gzip or deflate.",
        "content": {
            "application/json": {"schema": {"$ref": "#/components/schemas/InferRequestBody"}, "examples": INFERENCE}
        },
    }
}
_RAW_EXAMPLE, _ = render(
    {"model_name": "push-indicator", "model_version": "1"},
    {"mean": np.array([[0.021, 0.001, 0.03]], dtype=np.float32)},
    frozenset(["mean"]),
)
_RAW_ANSWER: Final = {  # a document in JSON has no other way to show bytes
    "externalValue": "data:application/octet-stream;base64," + base64.b64encode(_RAW_EXAMPLE).decode()
}
_INFER_RESPONSES: Final = {
    200: {
        "description": "JSON; or, when an output was asked for as raw bytes, JSON of as many bytes as the header "
        "Inference-Header-Content-Length says, and the bytes behind it",
        "content": {
            "application/octet-stream": {
                "schema": {"type": "string", "format": "binary"},
                "examples": {"mean": {"summary": "mean, as raw bytes"} | _RAW_ANSWER},
            }
        },
    },
    **protocol_errors(ErrorBody, *_INFERRED),
}

health = APIRouter(tags=["open inference"])
router = APIRouter(tags=["open inference"])
inference = APIRouter(route_class=EndpointRoute, tags=["open inference"])


@health.get("/v2/health/live", summary="Does the process answer?")
async def live() -> ServerLiveBody:
    """Always true: who can read it knows."""
    return ServerLiveBody()


@health.get(
    "/v2/health/ready",
    summary="Can any model be asked?",
    responses=protocol_errors(ErrorBody, ModelNotReadyError, *_AT_ONCE),
)
async def ready(request: Request) -> ServerReadyBody:
    """200 while a model that passed all its checks answers, else 503."""
    reason = readiness_of(request).reason()
    if reason is not None:
        raise ModelNotReadyError(reason)
    return ServerReadyBody(live=True, ready=True)


@router.get("/v2", summary="What serves")
async def server() -> ServerBody:
    """Name, version and extensions of the server."""
    return ServerBody(version=service.__version__, extensions=["binary_tensor_data"])


@router.get(
    "/v2/models/{name}", summary="A model's tensors", responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError)
)
async def model_metadata(request: Request, name: Name) -> ModelMetadataBody:
    """Names, types and shapes of inputs and outputs of the champion, and the versions that are served."""
    return _metadata(request, name, None)


@router.get(
    "/v2/models/{name}/versions/{version}",
    summary="A version's tensors",
    responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError),
)
async def version_metadata(request: Request, name: Name, version: Version) -> ModelMetadataBody:
    """Names, types and shapes of inputs and outputs, and the versions that are served."""
    return _metadata(request, name, version)


@router.get(
    "/v2/models/{name}/ready",
    summary="Can this model be asked?",
    responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError),
)
async def model_ready(request: Request, name: Name) -> ModelReadyBody:
    """200 when its champion is loaded, passed its checks and answers."""
    return _ready(request, name, None)


@router.get(
    "/v2/models/{name}/versions/{version}/ready",
    summary="Can this version be asked?",
    responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError),
)
async def version_ready(request: Request, name: Name, version: Version) -> ModelReadyBody:
    """200 when it is loaded, passed its checks and answers; a version that is not served is not there."""
    return _ready(request, name, version)


@inference.post(
    MODEL_PATH,
    summary="Ask a model: tensors in, tensors out",
    response_model=InferResponseBody,
    responses=_INFER_RESPONSES,
    openapi_extra=_INFER_BODY,
)
async def ask_model(name: Name) -> None:
    """The same predictions as /v1, as tensors; the champion answers, and says which version it is."""


@inference.post(
    VERSION_PATH,
    summary="Ask a version: tensors in, tensors out",
    response_model=InferResponseBody,
    responses=_INFER_RESPONSES,
    openapi_extra=_INFER_BODY,
)
async def ask_version(name: Name, version: Version) -> None:
    """The same predictions as /v1, as tensors."""


def _metadata(request: Request, name: str, version: str | None) -> ModelMetadataBody:
    models = snapshot_of(request)
    manifest = models.find(parse_reference(name, version)).manifest
    return ModelMetadataBody(
        name=manifest.name,
        versions=[str(number) for number in models.versions(manifest.name)],
        inputs=[_tensor_body(tensor) for tensor in manifest.inputs],
        outputs=[_tensor_body(tensor) for tensor in manifest.outputs],
    )


def _ready(request: Request, name: str, version: str | None) -> ModelReadyBody:
    manifest = snapshot_of(request).find(parse_reference(name, version)).manifest
    reason = readiness_of(request).reason_against(manifest.name, manifest.version)
    if reason is not None:
        raise ModelNotReadyError(f"{manifest.name}@{manifest.version}: {reason}")
    return ModelReadyBody(name=manifest.name)


def _tensor_body(tensor: Tensor) -> TensorBody:
    shape = [size if isinstance(size, int) else -1 for size in tensor.shape]
    return TensorBody(name=tensor.name, datatype=DATATYPES[tensor.dtype], shape=shape)


def describe_infer(document: dict[str, Any]) -> dict[str, Any]:
    """Add the schema of inference requests to an OpenAPI document: their routes read bytes, FastAPI knows of none."""
    schema = InferRequestBody.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas = document["components"]["schemas"]
    schemas |= {**schema.pop("$defs"), "InferRequestBody": schema}
    for path, operations in document["paths"].items():
        for operation in operations.values() if path.startswith("/v2") else ():
            operation["responses"].pop("422", None)  # what FastAPI expects of its parameters is a 400 here
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    return document
