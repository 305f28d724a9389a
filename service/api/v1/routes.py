"""The /v1 endpoints and the health routes: parse, call one function, render."""

from collections.abc import Callable, Coroutine
from typing import Annotated, Any, Final, TypeVar

import pydantic_core
from fastapi import APIRouter, Depends, Path, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import ValidationError

from service.api.dependencies import may_predict, respond, snapshot_of, takes_json, workers_of
from service.api.openapi import problems
from service.api.v1.catalogue import model_body, models_body, version_body
from service.api.v1.queries import describe_upload, is_light, predict_batch, predict_one, predict_upload
from service.api.v1.request_examples import IMAGE_UPLOAD, MANY_PUSHES, ONE_PUSH, PUSH_UPLOAD
from service.api.v1.uploads import Upload, read_upload
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
from service.inference.query import Answer
from service.inference.snapshot import Snapshot
from service.schemas.contexts import VisualContextBody
from service.schemas.models import ModelBody, ModelsBody, ModelVersionDetailBody
from service.schemas.predictions import BatchResponse, PredictResponse
from service.schemas.problems import ProblemBody
from service.schemas.pushes import BatchRequest, PredictRequest

P = TypeVar("P", PredictRequest, BatchRequest)
Name = Annotated[str, Path(max_length=64, description="name of a model", examples=["push-indicator"])]
Version = Annotated[int, Path(ge=1, le=999_999_999, description="version of the model", examples=[1])]
_AT_ONCE: Final = (TooManyRequestsError, OverloadedError)  # whatever is asked for
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
_BAD_NAME: Final = InvalidRequestError.at(
    "path.name", "a text of 65 characters", "String should have at most 64 characters"
)
_LOOKED_UP: Final = (UnknownModelError, NotAcceptableError, _BAD_NAME, *_AT_ONCE)
_PREDICTED: Final = (*_UPLOADED, UnknownModelError, ContextKindError, ModelNotReadyError, PredictionError, CazslError)
_NO_ENCODING: Final = "header Content-Encoding: received a compressed body; accepted is a plain one"


class StrictJsonRequest(Request):
    """A request whose body is read by a strict JSON parser: UTF-8 only, no lone surrogate, bounded nesting.

    It lets NaN and infinities through: the fields refuse them, and can say where they are.
    """

    async def json(self) -> Any:
        """The document.

        Raises:
            MalformedBodyError: it is none.
        """
        if not hasattr(self, "_json"):
            try:
                self._json = pydantic_core.from_json(await self.body())
            except ValueError as error:
                raise MalformedBodyError(f"body: received no JSON ({error}); accepted is JSON in UTF-8") from error
        return self._json


class StrictJsonRoute(APIRoute):
    """A route that takes JSON bodies declared as such, and reads them strictly."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Wrap the route's own handler."""
        handler = super().get_route_handler()
        takes_body = self.body_field is not None

        async def strict(request: Request) -> Response:
            """Refuse what is no JSON before the framework sees it, and before that who may not ask."""
            if not takes_body:
                return await handler(request)
            await may_predict(request)
            await takes_json(request)
            if "content-encoding" in request.headers:
                raise UnsupportedMediaTypeError(_NO_ENCODING)
            if not _is_json(request.headers.get("content-type", "")):
                accepted = "header Content-Type: received something else or nothing; accepted is application/json"
                raise UnsupportedMediaTypeError(accepted)
            strict_request = StrictJsonRequest(request.scope, request.receive)
            await strict_request.json()  # here, since the handler would hide our error behind one of its own
            return await handler(strict_request)

        return strict


router = APIRouter(route_class=StrictJsonRoute, dependencies=[Depends(takes_json)])
uploads = APIRouter(dependencies=[Depends(takes_json)])


@router.post(
    "/v1/predict",
    tags=["predict"],
    summary="Where does this object end up after this push, and how sure is that?",
    response_model=PredictResponse,
    responses=problems(ProblemBody, *_PREDICTED),
    openapi_extra=ONE_PUSH,
)
async def predict(request: Request, body: PredictRequest) -> Response:
    """Predict one push, in the object frame, or in the world when `object_pose` says where the object is."""
    return respond(request, await _answer(request, predict_one, body))


@router.post(
    "/v1/predict/batch",
    tags=["predict"],
    summary="The same for up to 10,000 pushes, of one object or of many",
    response_model=BatchResponse,
    responses=problems(ProblemBody, *_PREDICTED),
    openapi_extra=MANY_PUSHES,
)
async def predict_many(request: Request, body: BatchRequest) -> Response:
    """Predict pushes in columns: one row each of pushers, mean and std. A row's answer depends on that row only."""
    return respond(request, await _answer(request, predict_batch, body))


@uploads.post(
    "/v1/predict/image",
    tags=["predict"],
    summary="The same for the object in an image",
    response_model=PredictResponse | BatchResponse,
    responses=problems(ProblemBody, *_PREDICTED),
    openapi_extra=PUSH_UPLOAD,
)
async def predict_image(request: Request) -> Response:
    """Predict one push (`pusher`) or many (`pushers`) of the object in a top-down view."""
    try:
        return respond(request, await _of_upload(request, predict_upload))
    except ValidationError as error:
        found = error.errors(include_url=False)
        raise RequestValidationError([{**fault, "loc": ("body", *fault["loc"])} for fault in found]) from error


@uploads.post(
    "/v1/contexts",
    tags=["predict"],
    summary="What does a model see of this image?",
    response_model=VisualContextBody,
    responses=problems(ProblemBody, *_UPLOADED),
    openapi_extra=IMAGE_UPLOAD,
)
async def make_context(request: Request) -> Response:
    """Turn a top-down view into the visual context that predictions take, with a picture of it and what looks wrong."""
    return respond(request, await _of_upload(request, describe_upload))


@router.get(
    "/v1/models",
    tags=["models"],
    summary="What is served",
    responses=problems(ProblemBody, NotAcceptableError, *_AT_ONCE),
)
async def list_models(request: Request) -> ModelsBody:
    """Every model that is served, with its versions and aliases."""
    return models_body(snapshot_of(request))


@router.get("/v1/models/{name}", tags=["models"], summary="One model", responses=problems(ProblemBody, *_LOOKED_UP))
async def show_model(request: Request, name: Name) -> ModelBody:
    """One model, with its versions and aliases."""
    return model_body(snapshot_of(request), name)


@router.get(
    "/v1/models/{name}/versions/{version}",
    tags=["models"],
    summary="One version",
    responses=problems(ProblemBody, *_LOOKED_UP, ModelNotReadyError),
)
async def show_version(request: Request, name: Name, version: Version) -> ModelVersionDetailBody:
    """One version with its manifest (data, metrics, tensors with units, digests) and its card."""
    return version_body(snapshot_of(request), name, version)


async def _of_upload(request: Request, answer: Callable[[Snapshot, Upload], Answer]) -> Answer:
    """What is made of an upload: read and worked on in one go, since each handing over costs the loop time."""
    if "content-encoding" in request.headers:
        raise UnsupportedMediaTypeError(_NO_ENCODING)
    models, headers, content = snapshot_of(request), request.headers, await request.body()
    return await workers_of(request).run(lambda: answer(models, read_upload(headers, content)))


async def _answer(request: Request, predict: Callable[[Snapshot, P], Answer], body: P) -> Answer:
    """Light work here, since a thread would cost more than it; the rest in a thread."""
    models = snapshot_of(request)
    return predict(models, body) if is_light(body) else await workers_of(request).run(predict, models, body)


def _is_json(content_type: str) -> bool:
    media_type = content_type.partition(";")[0].strip().lower()
    return media_type == "application/json" or (media_type.startswith("application/") and media_type.endswith("+json"))
