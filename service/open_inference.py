"""The /v2 endpoints: the Open Inference Protocol over the same models, for clients that speak it already.

Names, fields and statuses are the protocol's (Open Inference Protocol V2, REST); where servers differ, the answer is
one that every known client reads: both ``live`` and ``ready`` in health, ``model_name`` in every inference, versions as
texts, errors as ``{"error": text}`` in plain ``application/json``.
"""

from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Path, Request, Response
from pydantic import Field
from pydantic.config import JsonDict

import service
from service.access import readiness_of, respond, snapshot_of, workers_of
from service.errors import ModelNotReadyError
from service.inference import LENGTH_HEADER, LIGHT_BYTES, InferRequest, infer, inflate, parse_reference
from service.manifest import Tensor
from service.schemas import Body
from service.tensors import DATATYPES

_PUSHER_EXAMPLE: Final = {"name": "pusher", "datatype": "FP32", "shape": [1, 3], "data": [-0.075, 0.0, 0.0]}
_OUTPUT_EXAMPLE: Final = {"name": "mean", "datatype": "FP32", "shape": [1, 3], "data": [0.021, 0.001, 0.03]}
_METADATA_EXAMPLE: Final = {"name": "pusher", "datatype": "FP32", "shape": [-1, 3]}

_PART: Final = "[a-z0-9][a-z0-9_-]{0,63}"
# for the document only: our own words say what is wrong with a name
_NAME: Final[JsonDict] = {"pattern": f"^{_PART}(@[a-z][a-z0-9_-]{{0,63}})?$"}
_VERSION: Final[JsonDict] = {"pattern": "^[1-9][0-9]{0,8}$"}
Name = Annotated[str, Path(description="a model, or model@alias", examples=["push-indicator"], json_schema_extra=_NAME)]
Version = Annotated[str, Path(description="version of the model", examples=["1"], json_schema_extra=_VERSION)]


class ErrorBody(Body):
    """What went wrong, as the protocol has it."""

    error: Annotated[
        str,
        Field(
            description="what was received, what is accepted and where",
            examples=["inputs pusher.shape: received another shape; accepted is [n (1 to 10000), 3]"],
        ),
    ]


class ServerLiveBody(Body):
    """The process answers."""

    live: Annotated[Literal[True], Field(description="always true", examples=[True])] = True


class ServerReadyBody(Body):
    """Whether any model can be asked."""

    live: Annotated[bool, Field(description="the protocol's word for ready", examples=[True])]
    ready: Annotated[bool, Field(description="what some clients look for", examples=[True])]


class ServerBody(Body):
    """What serves."""

    name: Annotated[str, Field(description="always cazsl", examples=["cazsl"])] = "cazsl"
    version: Annotated[str, Field(description="of the service", examples=["0.1.0"])]
    extensions: Annotated[
        list[str], Field(description="parts of the protocol beyond its core", examples=[["binary_tensor_data"]])
    ]


class ModelReadyBody(Body):
    """The model can be asked."""

    name: Annotated[str, Field(description="the model", examples=["push-indicator"])]
    ready: Annotated[Literal[True], Field(description="always true: otherwise the status is 404", examples=[True])] = (
        True
    )


class TensorBody(Body):
    """One tensor of a model."""

    name: Annotated[str, Field(description="of the tensor", examples=["pusher"])]
    datatype: Annotated[str, Field(description="FP32 or INT64", examples=["FP32"])]
    shape: Annotated[list[int], Field(description="-1 is free: n pushes or g objects", examples=[[-1, 3]])]


class ModelMetadataBody(Body):
    """A model as the protocol describes it."""

    name: Annotated[str, Field(description="the model", examples=["push-indicator"])]
    versions: Annotated[list[str], Field(description="versions served, oldest first", examples=[["1"]])]
    platform: Annotated[str, Field(description="always onnx_onnxv1", examples=["onnx_onnxv1"])] = "onnx_onnxv1"
    inputs: Annotated[
        list[TensorBody],
        Field(description="m, m, rad; context and context_index of the objects", examples=[[_METADATA_EXAMPLE]]),
    ]
    outputs: Annotated[list[TensorBody], Field(description="mean and std in m, m, rad", examples=[[_METADATA_EXAMPLE]])]


class InferTensorBody(Body):
    """A tensor with its numbers; as raw bytes behind the JSON it has parameters.binary_data_size instead of data."""

    name: Annotated[str, Field(description="of the tensor", examples=["pusher"])]
    datatype: Annotated[str, Field(description="FP32 or INT64", examples=["FP32"])]
    shape: Annotated[list[int], Field(description="of this tensor", examples=[[1, 3]])]
    parameters: Annotated[
        dict[str, bool | int | float | str] | None,
        Field(description="binary_data_size: its bytes behind the JSON", examples=[{"binary_data_size": 12}]),
    ] = None
    data: Annotated[
        list[Any] | None, Field(description="row-major; nested or flat in a request", examples=[[-0.075, 0.0, 0.0]])
    ] = None


class OutputBody(Body):
    """An output that is asked for."""

    name: Annotated[str, Field(description="mean or std", examples=["mean"])]
    parameters: Annotated[
        dict[str, bool | int | float | str] | None,
        Field(description="binary_data: as raw bytes", examples=[{"binary_data": False}]),
    ] = None


class InferRequestBody(Body):
    """An inference request; fields and parameters that the protocol knows and we do not are left alone."""

    id: Annotated[str | None, Field(max_length=256, description="comes back", examples=["42"])] = None
    parameters: Annotated[
        dict[str, bool | int | float | str] | None,
        Field(description="binary_data_output: all outputs as raw bytes", examples=[{"binary_data_output": False}]),
    ] = None
    inputs: Annotated[
        list[InferTensorBody],
        Field(
            description="pusher, and for models with context also context; context_index may be left out for one "
            "object or one per push",
            examples=[[_PUSHER_EXAMPLE]],
        ),
    ]
    outputs: Annotated[
        list[OutputBody] | None, Field(description="left out: mean and std", examples=[[{"name": "mean"}]])
    ] = None


class InferResponseBody(Body):
    """An inference."""

    model_name: Annotated[str, Field(description="which answered", examples=["push-indicator"])]
    model_version: Annotated[str, Field(description="its version", examples=["1"])]
    id: Annotated[str | None, Field(description="that of the request", examples=["42"])] = None
    outputs: Annotated[list[InferTensorBody], Field(description="in the order asked for", examples=[[_OUTPUT_EXAMPLE]])]


def _errors(*statuses: int) -> dict[int | str, dict[str, Any]]:
    return {status: {"description": "an error, as the protocol has it", "model": ErrorBody} for status in statuses}


_INFER_BODY: Final = {
    "requestBody": {
        "required": True,
        "description": "JSON; or, with the header Inference-Header-Content-Length, that many bytes of JSON and behind "
        "them the tensors that have a binary_data_size, little-endian, in the order of the JSON. May come compressed, "
        "as gzip or deflate.",
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/InferRequestBody"}}},
    }
}
_INFER_ERRORS: Final = _errors(400, 404, 408, 413, 415, 429, 500, 503)

health = APIRouter(tags=["open inference"])
router = APIRouter(tags=["open inference"])


@health.get("/v2/health/live", summary="Does the process answer?")
async def live() -> ServerLiveBody:
    """Always true: who can read it knows."""
    return ServerLiveBody()


@health.get("/v2/health/ready", summary="Can any model be asked?", responses=_errors(503))
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


@router.get("/v2/models/{name}", summary="A model's tensors", responses=_errors(400, 404))
async def model_metadata(request: Request, name: Name) -> ModelMetadataBody:
    """Names, types and shapes of inputs and outputs of the champion, and the versions that are served."""
    return _metadata(request, name, None)


@router.get("/v2/models/{name}/versions/{version}", summary="A version's tensors", responses=_errors(400, 404))
async def version_metadata(request: Request, name: Name, version: Version) -> ModelMetadataBody:
    """Names, types and shapes of inputs and outputs, and the versions that are served."""
    return _metadata(request, name, version)


@router.get("/v2/models/{name}/ready", summary="Can this model be asked?", responses=_errors(400, 404, 503))
async def model_ready(request: Request, name: Name) -> ModelReadyBody:
    """200 when its champion is loaded, passed its checks and answers."""
    return _ready(request, name, None)


@router.get(
    "/v2/models/{name}/versions/{version}/ready", summary="Can this version be asked?", responses=_errors(400, 404, 503)
)
async def version_ready(request: Request, name: Name, version: Version) -> ModelReadyBody:
    """200 when it is loaded, passed its checks and answers; a version that is not served is not there."""
    return _ready(request, name, version)


@router.post(
    "/v2/models/{name}/infer",
    summary="Ask a model: tensors in, tensors out",
    response_model=InferResponseBody,
    responses=_INFER_ERRORS,
    openapi_extra=_INFER_BODY,
)
async def ask_model(request: Request, name: Name) -> Response:
    """The same predictions as /v1, as tensors; the champion answers, and says which version it is."""
    return await _ask(request, name, None)


@router.post(
    "/v2/models/{name}/versions/{version}/infer",
    summary="Ask a version: tensors in, tensors out",
    response_model=InferResponseBody,
    responses=_INFER_ERRORS,
    openapi_extra=_INFER_BODY,
)
async def ask_version(request: Request, name: Name, version: Version) -> Response:
    """The same predictions as /v1, as tensors."""
    return await _ask(request, name, version)


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


async def _ask(request: Request, name: str, version: str | None) -> Response:
    content, encoding = await request.body(), request.headers.get("content-encoding")
    if encoding is not None and encoding.lower() != "identity":
        content = await workers_of(request).run(inflate, content, encoding, request.app.state.max_body_bytes)
    asked = InferRequest(name, version, request.headers.get(LENGTH_HEADER), content)
    if len(content) <= LIGHT_BYTES:
        return respond(request, infer(snapshot_of(request), asked))
    return respond(request, await workers_of(request).run(infer, snapshot_of(request), asked))


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
