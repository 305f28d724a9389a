"""Routes of ``/v1``: documentation of the endpoints, and the catalogue of models."""

from typing import Annotated, Final

from fastapi import APIRouter, Depends, Path, Request

from service.api.dependencies import snapshot_of
from service.api.endpoint_route import EndpointRoute
from service.api.openapi import problems
from service.api.v1.catalogue import model_body, models_body, version_body
from service.api.v1.endpoints import check_accept
from service.api.v1.request_examples import IMAGE_UPLOAD, MANY_PUSHES, ONE_PUSH, PUSH_UPLOAD
from service.errors import (
    BodyTooLargeError,
    CazslError,
    ContextKindError,
    DeadlineError,
    ImageTooLargeError,
    InvalidImageError,
    InvalidRequestError,
    MalformedBodyError,
    ModelNotReadyError,
    NotAcceptableError,
    OverloadedError,
    PredictionError,
    SlowBodyError,
    TooManyRequestsError,
    UnknownModelError,
    UnsupportedImageError,
    UnsupportedMediaTypeError,
)
from service.schemas.image_contexts import OutlineContextBody, VisualContextBody
from service.schemas.models import ModelBody, ModelsBody, ModelVersionDetailBody
from service.schemas.predictions import BatchResponse, PredictResponse
from service.schemas.problems import ProblemBody
from service.schemas.pushes import BatchRequest, PredictRequest

Name = Annotated[str, Path(max_length=64, description="name of a model", examples=["push-indicator"])]
Version = Annotated[int, Path(ge=1, le=999_999_999, description="version of the model", examples=[1])]
_AT_ONCE: Final = (TooManyRequestsError, OverloadedError)  # on every route
_UPLOADED: Final = (
    MalformedBodyError,
    NotAcceptableError,
    SlowBodyError,
    BodyTooLargeError,
    ImageTooLargeError,
    UnsupportedMediaTypeError,
    UnsupportedImageError,
    InvalidRequestError,
    InvalidImageError,
    DeadlineError,
    *_AT_ONCE,
)
_BAD_NAME: Final = InvalidRequestError.at("path.name", "a text of 65 characters", "at most 64 characters")
_LOOKED_UP: Final = (UnknownModelError, NotAcceptableError, _BAD_NAME, *_AT_ONCE)
PREDICTED: Final = (*_UPLOADED, UnknownModelError, ContextKindError, ModelNotReadyError, PredictionError, CazslError)


async def takes_json(request: Request) -> None:
    """Require that the caller accepts JSON, as a dependency.

    Raises:
        NotAcceptableError: its Accept header excludes JSON.
    """
    check_accept(request.scope["headers"])


predictions = APIRouter(route_class=EndpointRoute, tags=["predict"])
models = APIRouter(dependencies=[Depends(takes_json)], tags=["models"])


@predictions.post(
    "/v1/predict",
    summary="Predict one push",
    response_model=PredictResponse,
    responses=problems(ProblemBody, *PREDICTED),
    openapi_extra=ONE_PUSH,
)
async def predict(body: PredictRequest) -> None:
    """Predict the pose of an object after one push, as a Gaussian.

    The answer is in the object frame, or in the world frame if `object_pose` is sent.
    """


@predictions.post(
    "/v1/predict/batch",
    summary="Predict up to 10,000 pushes of one or several objects",
    response_model=BatchResponse,
    responses=problems(ProblemBody, *PREDICTED),
    openapi_extra=MANY_PUSHES,
)
async def predict_many(body: BatchRequest) -> None:
    """Predict pushes in columns: each push is one row of `pushers`, `mean` and `std`.

    The prediction of a row depends on that row and its context only.
    """


@predictions.post(
    "/v1/predict/image",
    summary="Predict pushes of the object in an image",
    response_model=PredictResponse | BatchResponse,
    responses=problems(ProblemBody, *PREDICTED),
    openapi_extra=PUSH_UPLOAD,
)
async def predict_image() -> None:
    """Predict one push (`pusher`) or several (`pushers`) of the object in a top-down image."""


@predictions.post(
    "/v1/contexts",
    summary="Convert an image into a context",
    response_model=VisualContextBody | OutlineContextBody,
    responses=problems(ProblemBody, *_UPLOADED),
    openapi_extra=IMAGE_UPLOAD,
)
async def make_context() -> None:
    """Convert a top-down image into the visual context that predictions take.

    The answer also has a thumbnail of the context, and flags for faults of the image. With `metres_per_pixel`, the
    scale of the image, the answer is instead the outline of the object: as a context that predictions take, and in
    pixels, to draw over the image.
    """


@models.get(
    "/v1/models",
    summary="List the served models",
    responses=problems(ProblemBody, NotAcceptableError, *_AT_ONCE),
)
async def list_models(request: Request) -> ModelsBody:
    """Return every served model with its versions and aliases."""
    return models_body(snapshot_of(request))


@models.get("/v1/models/{name}", summary="Show a model", responses=problems(ProblemBody, *_LOOKED_UP))
async def show_model(request: Request, name: Name) -> ModelBody:
    """Return a model with its versions and aliases."""
    return model_body(snapshot_of(request), name)


@models.get(
    "/v1/models/{name}/versions/{version}",
    summary="Show a version of a model",
    responses=problems(ProblemBody, *_LOOKED_UP, ModelNotReadyError),
)
async def show_version(request: Request, name: Name, version: Version) -> ModelVersionDetailBody:
    """Return a version with its manifest (data, metrics, tensors with units, digests) and its model card."""
    return version_body(snapshot_of(request), name, version)
