"""Routes of the Open Inference Protocol over the models of ``/v1``, for clients that implement it already.

Names, fields and statuses are the protocol's (Open Inference Protocol V2, REST). Where servers differ, the answer is
one that every known client reads: both ``live`` and ``ready`` in health, ``model_name`` in every inference, versions as
texts, errors as ``{"error": text}`` in plain ``application/json``.
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

# For the document only: ``ModelReference`` checks names, with better error messages.
_NAME: Final[JsonDict] = {"pattern": f"^{NAME_PATTERN}(@{ALIAS_PATTERN})?$"}
_VERSION: Final[JsonDict] = {"pattern": f"^{VERSION_PATTERN}$"}
Name = Annotated[
    str, Path(description="name of a model, or name@alias", examples=["push-indicator"], json_schema_extra=_NAME)
]
Version = Annotated[str, Path(description="version of the model", examples=["1"], json_schema_extra=_VERSION)]
_AT_ONCE: Final = (TooManyRequestsError, OverloadedError)  # on every route
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
        "description": "JSON. With the header Inference-Header-Content-Length: that number of bytes of JSON, followed "
        "by the tensors that have a binary_data_size, little-endian, in the order of the JSON. The body may be "
        "compressed with gzip or deflate.",
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
_RAW_ANSWER: Final = {  # a JSON document cannot hold bytes in another way
    "externalValue": "data:application/octet-stream;base64," + base64.b64encode(_RAW_EXAMPLE).decode()
}
_INFER_RESPONSES: Final = {
    200: {
        "description": "JSON. If an output is requested as raw bytes: JSON with the number of bytes in the header "
        "Inference-Header-Content-Length, followed by the raw bytes",
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


@health.get("/v2/health/live", summary="Liveness of the process")
async def live() -> ServerLiveBody:
    """Return `live`, which is always true."""
    return ServerLiveBody()


@health.get(
    "/v2/health/ready",
    summary="Readiness for predictions",
    responses=protocol_errors(ErrorBody, ModelNotReadyError, *_AT_ONCE),
)
async def ready(request: Request) -> ServerReadyBody:
    """Return 200 while at least one loaded model passes its self-checks, else 503."""
    reason = readiness_of(request).reason()
    if reason is not None:
        raise ModelNotReadyError(reason)
    return ServerReadyBody(live=True, ready=True)


@router.get("/v2", summary="Metadata of the server")
async def server() -> ServerBody:
    """Return name, version and extensions of the server."""
    return ServerBody(version=service.__version__, extensions=["binary_tensor_data"])


@router.get(
    "/v2/models/{name}",
    summary="Metadata of a model",
    responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError),
)
async def model_metadata(request: Request, name: Name) -> ModelMetadataBody:
    """Return names, types and shapes of the inputs and outputs of the champion, and the served versions."""
    return _metadata(request, name, None)


@router.get(
    "/v2/models/{name}/versions/{version}",
    summary="Metadata of a version",
    responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError),
)
async def version_metadata(request: Request, name: Name, version: Version) -> ModelMetadataBody:
    """Return names, types and shapes of the inputs and outputs of a version, and the served versions."""
    return _metadata(request, name, version)


@router.get(
    "/v2/models/{name}/ready",
    summary="Readiness of a model",
    responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError),
)
async def model_ready(request: Request, name: Name) -> ModelReadyBody:
    """Return 200 if the champion is loaded and its last self-check passed, else 503."""
    return _ready(request, name, None)


@router.get(
    "/v2/models/{name}/versions/{version}/ready",
    summary="Readiness of a version",
    responses=protocol_errors(ErrorBody, *_NAMED, ModelNotReadyError),
)
async def version_ready(request: Request, name: Name, version: Version) -> ModelReadyBody:
    """Return 200 if the version is loaded and its last self-check passed, else 503. Unknown versions are a 404."""
    return _ready(request, name, version)


@inference.post(
    MODEL_PATH,
    summary="Predict with a model: tensors in, tensors out",
    response_model=InferResponseBody,
    responses=_INFER_RESPONSES,
    openapi_extra=_INFER_BODY,
)
async def ask_model(name: Name) -> None:
    """Predict as /v1 does, with tensors. The champion answers, and the answer names its version."""


@inference.post(
    VERSION_PATH,
    summary="Predict with a version: tensors in, tensors out",
    response_model=InferResponseBody,
    responses=_INFER_RESPONSES,
    openapi_extra=_INFER_BODY,
)
async def ask_version(name: Name, version: Version) -> None:
    """Predict as /v1 does, with tensors."""


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
    """Add the schema of inference requests to an OpenAPI document. FastAPI cannot derive it: routes read bytes."""
    schema = InferRequestBody.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas = document["components"]["schemas"]
    schemas |= {**schema.pop("$defs"), "InferRequestBody": schema}
    for path, operations in document["paths"].items():
        for operation in operations.values() if path.startswith("/v2") else ():
            operation["responses"].pop("422", None)  # parameters that are not valid are a 400 here
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    return document
