"""Requests and answers of the clients: arguments to request bodies, answers to arrays and bodies.

This module sends no requests. The blocking client, the asyncio client and the client in this process share it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np
import numpy.typing as npt
import orjson
from pydantic import ValidationError

from service.client.arguments import (
    POSE_PARTS,
    Context,
    Details,
    Image,
    ScaledDetails,
    context_document,
    detail_fields,
    finite_array,
    image_content,
    index_array,
    lengths_field,
    pose_document,
    pose_rows,
)
from service.client.errors import ProblemError, UnreadableAnswerError
from service.errors import FieldFault
from service.model.reference import is_name
from service.schemas.body import Body
from service.schemas.image_contexts import OutlineContextBody, VisualContextBody
from service.schemas.models import ModelBody, ModelsBody, ModelVersionBody, ModelVersionDetailBody
from service.schemas.predictions import BatchResponse, BatchWarningBody, PredictResponse
from service.schemas.problems import ProblemBody

T = TypeVar("T")
B = TypeVar("B", bound=Body)
Numbers = npt.NDArray[np.floating[Any]]
NAME_SYNTAX: Final = "1 to 64 lower-case letters, digits, '-' and '_', not starting with '-' or '_'"
_PHRASES: Final = {int(status): status.phrase for status in HTTPStatus}
_JSON: Final = {"Content-Type": "application/json"}
MAX_ANSWER_BYTES: Final = 1 << 20
MAX_CATALOGUE_BYTES: Final = 4 << 20  # a list of 10,000 models, or a manifest with its card
_PROBLEM_BYTES: Final = 64 * 1024
_ROW_BYTES: Final = 1024  # more than one push in the world frame: 15 numbers of up to 24 digits, with their brackets
_BRACKETS, _ROW_BRACKETS = 100, 16  # of arrays. A push in the world frame has 6, and rows take 50 times their bytes.
_LISTED_FAULTS: Final = 100  # to list the faults takes a thousand times the memory of the answer


@dataclass(frozen=True, slots=True)
class Predictions:
    """Gaussians over the object's pose after each push, in the order of the request.

    Attributes:
        model: model and version that answered.
        frame: ``object`` or ``world``, the frame of all poses here.
        mean: (n, 3) x, y, angle in m, m, rad. The angle is in (-pi, pi].
        std: (n, 3) standard deviations in m, m, rad.
        covariance: (n, 3, 3) in the world frame, where x and y are correlated. None in the object's frame.
        warnings: reasons not to rely on some rows, none if empty. Each has a code, a detail and the rows.

    The numbers are float32 in the object's frame, exactly the model's, and float64 in the world frame.
    """

    model: ModelVersionBody
    frame: Literal["object", "world"]
    mean: Numbers
    std: Numbers
    covariance: Numbers | None
    warnings: tuple[BatchWarningBody, ...] = ()


@dataclass(frozen=True, slots=True)
class Call(Generic[T]):
    """One request and the parser of its answer."""

    method: str
    path: str
    parse: Callable[[bytes], T]
    body: Mapping[str, Any]
    """Body as keyword arguments of httpx: ``content`` and ``headers``, or ``data`` and ``files``."""
    max_answer_bytes: int = MAX_ANSWER_BYTES
    """Maximum bytes of an answer. A service of ours sends less, and another server gets no more of our memory."""

    def read(self, status: int, content: bytes, retry_after_s: float | None) -> T:
        """Parse the answer.

        Raises:
            ProblemError: the service refused the request.
            UnreadableAnswerError: the answer is not that of a CAZSL service.
        """
        if status != HTTPStatus.OK:
            raise _problem(status, content, retry_after_s)
        try:
            return self.parse(content)
        except ValidationError as error:
            raise UnreadableAnswerError(
                f"{self.path}: the answer cannot be read: {_reason(error)}; is this a CAZSL service?"
            ) from error


def predict(
    pusher: npt.ArrayLike,
    context: Context | None,
    model: str | None,
    object_pose: npt.ArrayLike | None,
    length: float | None = None,
) -> Call[PredictResponse]:
    """Build the request for one push."""
    document: dict[str, Any] = {"pusher": pose_document(pusher, "pusher"), **model_field(model)}
    if length is not None:
        document["pusher"]["length"] = float(finite_array(length, "length"))
    if context is not None:
        document["context"] = context_document(context)
    if object_pose is not None:
        document["object_pose"] = pose_document(object_pose, "object_pose")
    return post("/v1/predict", document, _reader(PredictResponse))


def predict_batch(
    pushers: npt.ArrayLike,
    contexts: Context | Sequence[Context] | None,
    context_index: npt.ArrayLike | None,
    model: str | None,
    object_poses: npt.ArrayLike | None,
    lengths: npt.ArrayLike | None = None,
) -> Call[Predictions]:
    """Build the request for many pushes."""
    rows = pose_rows(pushers, "pushers")
    document: dict[str, Any] = {"pushers": rows, **lengths_field(lengths), **model_field(model)}
    if contexts is not None:
        several = [contexts] if isinstance(contexts, Context) else contexts
        document["contexts"] = [context_document(context) for context in several]
    if context_index is not None:
        document["context_index"] = index_array(context_index)
    if object_poses is not None:
        document["object_poses"] = pose_rows(object_poses, "object_poses")
    max_answer_bytes = MAX_ANSWER_BYTES + len(rows) * _ROW_BYTES
    return post("/v1/predict/batch", document, lambda content: _predictions(content, len(rows)), max_answer_bytes)


def predict_image(
    image: Image,
    pushers: npt.ArrayLike,
    model: str | None,
    object_poses: npt.ArrayLike | None,
    lengths: npt.ArrayLike | None = None,
    details: Details | ScaledDetails | None = None,
) -> Call[Predictions]:
    """Build the request for many pushes of the object in an image."""
    rows = pose_rows(pushers, "pushers")
    given = {"pushers": rows, **lengths_field(lengths), **detail_fields(details or {})}
    fields = {name: _dump(value) for name, value in given.items()} | model_field(model)
    if object_poses is not None:
        fields["object_poses"] = _dump(pose_rows(object_poses, "object_poses"))
    body = {"data": fields, "files": {"image": ("image", image_content(image))}}
    max_answer_bytes = MAX_ANSWER_BYTES + len(rows) * _ROW_BYTES
    return Call("POST", "/v1/predict/image", lambda content: _predictions(content, len(rows)), body, max_answer_bytes)


def make_context(image: Image) -> Call[VisualContextBody]:
    """Build the request for the visual context of an image."""
    return Call(
        "POST", "/v1/contexts", _reader(VisualContextBody), {"files": {"image": ("image", image_content(image))}}
    )


def find_outline(image: Image, details: ScaledDetails) -> Call[OutlineContextBody]:
    """Build the request for the outline of the object in an image whose scale is known."""
    fields = {name: _dump(value) for name, value in detail_fields(details).items()}
    body = {"data": fields, "files": {"image": ("image", image_content(image))}}
    return Call("POST", "/v1/contexts", _reader(OutlineContextBody), body)


def list_models() -> Call[ModelsBody]:
    """Build the request for all models."""
    return Call("GET", "/v1/models", _reader(ModelsBody), {}, MAX_CATALOGUE_BYTES)


def show_model(name: str) -> Call[ModelBody]:
    """Build the request for one model."""
    return Call("GET", f"/v1/models/{_segment(name)}", _reader(ModelBody), {}, MAX_CATALOGUE_BYTES)


def show_version(name: str, version: int) -> Call[ModelVersionDetailBody]:
    """Build the request for one version with its manifest and card."""
    path = f"/v1/models/{_segment(name)}/versions/{version:d}"
    return Call("GET", path, _reader(ModelVersionDetailBody), {}, MAX_CATALOGUE_BYTES)


def post(
    path: str, document: dict[str, Any], parse: Callable[[bytes], T], max_answer_bytes: int = MAX_ANSWER_BYTES
) -> Call[T]:
    """Build a request with a document in JSON."""
    return Call("POST", path, parse, {"content": _dump(document), "headers": _JSON}, max_answer_bytes)


def _dump(document: object) -> bytes:
    try:
        return orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY)
    except TypeError as error:
        raise ProblemError.at(
            "request", f"a value that is none of JSON ({error})", "whole texts, and numbers"
        ) from error


def model_field(model: str | None) -> dict[str, Any]:
    """Return the field that names a model, if one is named.

    Raises:
        ProblemError: the name cannot be written as UTF-8.
    """
    if model is None:
        return {}
    try:
        str(model).encode()
    except UnicodeEncodeError as error:
        raise ProblemError.at("model", "a text with half a character", "name, name@alias or name@version") from error
    return {"model": model}


def _segment(name: str) -> str:
    """Return a model's name as a segment of a path. Another text could name another route."""
    if not is_name(name):
        raise ProblemError.at("name", f"a text of {len(name)} characters", NAME_SYNTAX)
    return name


def _reader(kind: type[B]) -> Callable[[bytes], B]:
    """Return a parser that validates known fields and ignores fields of later services."""
    return lambda content: kind.model_validate_json(content, extra="ignore")


def _reason(error: ValidationError) -> str:
    """Return the first fault of an answer with its place, or the number of faults if they are too many to list."""
    if error.error_count() > _LISTED_FAULTS:
        return f"{error.error_count()} faults"
    fault = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(str(part) for part in fault['loc']) or 'the answer'}: {fault['msg']}"


def _predictions(content: bytes, count: int) -> Predictions:
    if content.count(b"[") > _BRACKETS + count * _ROW_BRACKETS:
        raise UnreadableAnswerError(f"the answer has more rows than the {count} of the request")
    body = BatchResponse.model_validate_json(content, extra="ignore")
    kind = np.float32 if body.frame == "object" else np.float64
    return Predictions(
        body.model,
        body.frame,
        answer_array(body.mean, (count, POSE_PARTS), kind),
        answer_array(body.std, (count, POSE_PARTS), kind),
        None if body.covariance is None else answer_array(body.covariance, (count, POSE_PARTS, POSE_PARTS), kind),
        check_warnings(body.warnings, count),
    )


def check_warnings(warnings: Sequence[BatchWarningBody], count: int) -> tuple[BatchWarningBody, ...]:
    """Return the warnings of an answer with this many rows.

    Raises:
        UnreadableAnswerError: a warning is about a row that is none of them.
    """
    for warning in warnings:
        rows = warning.rows
        if len(rows) > count or not all(0 <= row < count for row in rows):
            raise UnreadableAnswerError(f"the answer warns of rows that are none of the {count} of the request")
    return tuple(warnings)


def answer_array(rows: Sequence[Any], shape: tuple[int, ...], kind: type[np.floating[Any]]) -> Numbers:
    """Return rows of an answer as an array of this shape.

    Raises:
        UnreadableAnswerError: they have another shape.
    """
    try:
        found = np.array(rows, dtype=kind)
    except ValueError as error:
        raise UnreadableAnswerError("the answer has rows of different lengths") from error
    if found.shape != shape:
        raise UnreadableAnswerError(f"the answer has an array of shape {found.shape}; expected {shape}")
    return found


def _problem(status: int, content: bytes, retry_after_s: float | None) -> ProblemError:
    try:
        # A problem has a few KiB. A longer text, such as the page of a proxy, is not parsed.
        body = ProblemBody.model_validate_json(content[:_PROBLEM_BYTES], extra="ignore")
    except ValidationError:
        phrase = _PHRASES.get(status, "unknown status")
        detail = (
            f"status {status} ({phrase}) without a problem document; is this a CAZSL service, or a proxy before it?"
        )
        return ProblemError("unexplained", detail, status, phrase, retry_after_s=retry_after_s)
    faults = [FieldFault(fault.where, fault.received, fault.accepted) for fault in body.errors]
    return ProblemError(body.code, body.detail, status, body.title, faults, body.request_id, retry_after_s)
