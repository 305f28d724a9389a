"""Requests and answers of the clients: arrays and files to request bodies, answers to arrays and bodies.

This module sends no requests. The blocking client, the asyncio client and the client in this process share it.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np
import numpy.typing as npt
import orjson
from pydantic import ValidationError

from service.client.errors import ProblemError, UnreadableAnswerError
from service.errors import FieldFault
from service.model.reference import is_name
from service.schemas.body import Body
from service.schemas.contexts import ContextBody, VisualContextBody
from service.schemas.models import ModelBody, ModelsBody, ModelVersionBody, ModelVersionDetailBody
from service.schemas.predictions import BatchResponse, PredictResponse
from service.schemas.problems import ProblemBody

T = TypeVar("T")
B = TypeVar("B", bound=Body)
Numbers = npt.NDArray[np.floating[Any]]
Context = str | ContextBody | VisualContextBody
"""Context of an object: a descriptor, any form of ``ContextBody``, or the result of ``make_context``."""
Image = bytes | str | os.PathLike[str]
"""The content of a PNG, JPEG or WebP file, or its path."""
NAME_SYNTAX: Final = "1 to 64 lower-case letters, digits, '-' and '_', not starting with '-' or '_'"
_POSE_PARTS: Final = 3
_REAL_KINDS: Final = "fiu"
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

    The numbers are float32 in the object's frame, exactly the model's, and float64 in the world frame.
    """

    model: ModelVersionBody
    frame: Literal["object", "world"]
    mean: Numbers
    std: Numbers
    covariance: Numbers | None


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
    pusher: npt.ArrayLike, context: Context | None, model: str | None, object_pose: npt.ArrayLike | None
) -> Call[PredictResponse]:
    """Build the request for one push."""
    document: dict[str, Any] = {"pusher": _pose(pusher, "pusher"), **_model_field(model)}
    if context is not None:
        document["context"] = _context(context)
    if object_pose is not None:
        document["object_pose"] = _pose(object_pose, "object_pose")
    return _post("/v1/predict", document, _reader(PredictResponse))


def predict_batch(
    pushers: npt.ArrayLike,
    contexts: Context | Sequence[Context] | None,
    context_index: npt.ArrayLike | None,
    model: str | None,
    object_poses: npt.ArrayLike | None,
) -> Call[Predictions]:
    """Build the request for many pushes."""
    rows = _rows(pushers, "pushers")
    document: dict[str, Any] = {"pushers": rows, **_model_field(model)}
    if contexts is not None:
        several = [contexts] if isinstance(contexts, Context) else contexts
        document["contexts"] = [_context(context) for context in several]
    if context_index is not None:
        document["context_index"] = _index(context_index)
    if object_poses is not None:
        document["object_poses"] = _rows(object_poses, "object_poses")
    return _post("/v1/predict/batch", document, lambda content: _predictions(content, len(rows)), len(rows))


def predict_image(
    image: Image, pushers: npt.ArrayLike, model: str | None, object_poses: npt.ArrayLike | None
) -> Call[Predictions]:
    """Build the request for many pushes of the object in an image."""
    rows = _rows(pushers, "pushers")
    fields = {"pushers": _dump(rows), **_model_field(model)}
    if object_poses is not None:
        fields["object_poses"] = _dump(_rows(object_poses, "object_poses"))
    body = {"data": fields, "files": {"image": ("image", _image(image))}}
    max_answer_bytes = MAX_ANSWER_BYTES + len(rows) * _ROW_BYTES
    return Call("POST", "/v1/predict/image", lambda content: _predictions(content, len(rows)), body, max_answer_bytes)


def make_context(image: Image) -> Call[VisualContextBody]:
    """Build the request for the visual context of an image."""
    return Call("POST", "/v1/contexts", _reader(VisualContextBody), {"files": {"image": ("image", _image(image))}})


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


def _post(path: str, document: dict[str, Any], parse: Callable[[bytes], T], rows: int = 0) -> Call[T]:
    body = {"content": _dump(document), "headers": _JSON}
    return Call("POST", path, parse, body, MAX_ANSWER_BYTES + rows * _ROW_BYTES)


def _dump(document: object) -> bytes:
    try:
        return orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY)
    except TypeError as error:
        raise ProblemError.at(
            "request", f"a value that is none of JSON ({error})", "whole texts, and numbers"
        ) from error


def _model_field(model: str | None) -> dict[str, Any]:
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


def _context(context: Context) -> dict[str, Any]:
    match context:
        case str():
            return {"descriptor": context}
        case VisualContextBody():
            return {"visual": context.visual}
        case _:
            return context.model_dump(exclude_none=True)


def _pose(pose: npt.ArrayLike, where: str) -> dict[str, float]:
    parts = _finite(pose, where)
    if parts.shape != (_POSE_PARTS,):
        raise ProblemError.at(where, f"shape {parts.shape}", "three numbers: x and y in m, angle in rad")
    return dict(zip(("x", "y", "angle"), parts.tolist(), strict=True))


def _rows(poses: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    rows = _finite(poses, where)
    if rows.ndim != 2 or rows.shape[1] != _POSE_PARTS:
        raise ProblemError.at(where, f"shape {rows.shape}", "shape (n, 3): x and y in m, angle in rad")
    return rows


def _finite(numbers: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    """Return the numbers as contiguous float64. NaN is refused here, because JSON would send null for it."""
    given = _as_array(numbers, where)
    if given.dtype.kind not in _REAL_KINDS:
        raise ProblemError.at(where, f"an array of {given.dtype}", "an array of real numbers")
    found = np.asarray(given, dtype=np.float64, order="C")
    wrong = np.argwhere(~np.isfinite(found))
    if len(wrong):
        index = ".".join(str(int(part)) for part in wrong[0])
        raise ProblemError.at(f"{where}.{index}", "a number that is not finite", "finite numbers")
    return found


def _as_array(numbers: npt.ArrayLike, where: str) -> npt.NDArray[Any]:
    try:
        return np.asarray(numbers)
    except ValueError as error:
        raise ProblemError.at(where, "rows of different lengths", "an array of real numbers") from error


def _index(index: npt.ArrayLike) -> npt.NDArray[np.int64]:
    found = _as_array(index, "context_index")
    if found.ndim != 1 or not np.issubdtype(found.dtype, np.integer):
        received = f"shape {found.shape} of {found.dtype}"
        raise ProblemError.at("context_index", received, "shape (n,) of integers: one per push")
    return np.ascontiguousarray(found, dtype=np.int64)


def _image(image: Image) -> bytes:
    return image if isinstance(image, bytes) else Path(image).read_bytes()


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
        _array(body.mean, (count, _POSE_PARTS), kind),
        _array(body.std, (count, _POSE_PARTS), kind),
        None if body.covariance is None else _array(body.covariance, (count, _POSE_PARTS, _POSE_PARTS), kind),
    )


def _array(rows: Sequence[Any], shape: tuple[int, ...], kind: type[np.floating[Any]]) -> Numbers:
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
