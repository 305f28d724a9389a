"""Inference as the Open Inference Protocol asks for it: tensors in, tensors out, by the same models and the same rules.

A push that ``/v1`` refuses is refused here: out of reach, or an object that cannot be. Levels of a visual context are
rounded to their 8 bits, as everywhere. Parameters other than those of the binary extension are left alone.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np

from service.api.open_inference.wire import Array, InferPart, read_inputs, read_json, render
from service.errors import (
    BodyTooLargeError,
    InvalidRequestError,
    MalformedBodyError,
    UnsupportedMediaTypeError,
)
from service.inference.query import Answer, Asked, Objects
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.reference import ModelReference, parse_version
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import ObjectContext
from service.pushing.onnx_interface import OUTPUTS
from service.pushing.poses import REACH_M, wrap_angles

LIGHT_BYTES: Final = 16 * 1024  # as much is read in about the time that handing it to a thread takes
_OUTPUT_NAMES: Final = tuple(tensor.name for tensor in OUTPUTS)
_WINDOW_BITS: Final = {"gzip": 16 + zlib.MAX_WBITS, "deflate": zlib.MAX_WBITS}


@dataclass(frozen=True, slots=True)
class InferRequest:
    """One request as it came: which model, and what its headers say of its body."""

    model: str
    version: str | None
    header_length: str | None
    content: bytes


def parse_reference(model: str, version: str | None) -> ModelReference:
    """The model that a path names.

    Raises:
        InvalidRequestError: name or version is none.
    """
    parsed = ModelReference.parse(model, "model")
    if version is None:
        return parsed
    number = parse_version(version)
    if number is None:
        raise InvalidRequestError.at("version", "no version", "a positive integer")
    return ModelReference(parsed.name, None, number)


def inflate(content: bytes, encoding: str, most: int) -> bytes:
    """The body behind a Content-Encoding, no more than so many bytes of it.

    Raises:
        UnsupportedMediaTypeError: another encoding.
        MalformedBodyError: it is not what it says.
        BodyTooLargeError: there is more of it.
    """
    bits = _WINDOW_BITS.get(encoding.strip().lower())
    if bits is None:
        raise UnsupportedMediaTypeError("header Content-Encoding: received another one; accepted is gzip or deflate")
    stream = zlib.decompressobj(bits)
    try:
        found = stream.decompress(content, most + 1)
    except zlib.error as error:
        raise MalformedBodyError("body: received something that its Content-Encoding is not") from error
    if len(found) > most:
        raise BodyTooLargeError(most)
    if not stream.eof or stream.unused_data:
        raise MalformedBodyError("body: received half a stream, or more than one; accepted is one whole stream")
    return found


@dataclass(frozen=True, slots=True)
class Inference(Asked):
    """Asked in tensors."""

    wanted: Mapping[str, bool]  # outputs, in order, and whether as bytes
    id: str | None

    def answered(self, mean: FloatArray, std: FloatArray) -> Answer:
        """See ``Asked.answered``."""
        name, version = self.model.manifest.name, self.model.manifest.version
        document: dict[str, Any] = {"model_name": name, "model_version": str(version)}
        if self.id is not None:
            document["id"] = self.id
        given = {"mean": mean, "std": std}
        outputs = {output: given[output] for output in self.wanted}
        binary = frozenset(output for output, is_binary in self.wanted.items() if is_binary)
        content, headers = render(document, outputs, binary)
        return Answer(content, self.notes(), headers)


def infer(models: Snapshot, request: InferRequest) -> Answer:
    """Answer one inference request.

    Raises:
        RequestError, ModelNotReadyError: as ``ask_inference``.
        PredictionError: as ``LoadedModel.predict``.
    """
    return ask_inference(models, request).answer()


def ask_inference(models: Snapshot, request: InferRequest) -> Inference:
    """What an inference request asks.

    Raises:
        RequestError: the request is not in order.
        ModelNotReadyError: as ``Snapshot.find``.
    """
    model = models.find(parse_reference(request.model, request.version))
    part, raw = read_json(request.content, request.header_length)
    wanted = _wanted_outputs(part)
    inputs = read_inputs(part, raw, model.manifest.inputs)
    pushers = _pushers(inputs.get("pusher"))
    objects = Objects(model.manifest.context_kind, *_contexts(model, inputs, len(pushers)))
    return Inference(model, pushers, objects, wanted, part.id)


def _wanted_outputs(part: InferPart) -> Mapping[str, bool]:
    """The outputs to give, in order, and whether as bytes; a flag of one output wins over that of all."""
    every = (part.parameters or {}).get("binary_data_output") is True
    if not part.outputs:
        return dict.fromkeys(_OUTPUT_NAMES, every)
    wanted: dict[str, bool] = {}
    for output in part.outputs:
        if output.name not in _OUTPUT_NAMES or output.name in wanted:
            accepted = f"each of {', '.join(_OUTPUT_NAMES)} once"
            raise InvalidRequestError.at("outputs", "an unknown output or one twice", accepted)
        wanted[output.name] = (output.parameters or {}).get("binary_data", every) is True
    return wanted


def _pushers(given: Array | None) -> FloatArray:
    """Pushes (n, 3) within reach, their angles wrapped."""
    if given is None:
        raise InvalidRequestError.at("inputs", "no tensor pusher", "pusher, FP32 [n, 3]")
    far = np.abs(given[:, :2]) > REACH_M
    if far.any():
        row = int(np.argwhere(far)[0][0])
        accepted = f"-{REACH_M:g} to {REACH_M:g} m along each of the object's axes"
        raise InvalidRequestError.at(f"inputs pusher[{row}]", "a push out of reach", accepted)
    pushers: FloatArray = given.astype(np.float32)
    pushers[:, 2] = wrap_angles(given[:, 2].astype(np.float64))
    return pushers


def _contexts(
    model: LoadedModel, inputs: Mapping[str, Array], count: int
) -> tuple[FloatArray | None, IndexArray | None]:
    """Objects and the place of each push's object; the index may be left out for one object, or one per push."""
    if model.manifest.context_kind is ContextKind.NONE:
        return None, None
    given, index = inputs.get("context"), inputs.get("context_index")
    if given is None:
        raise InvalidRequestError.at("inputs", "no tensor context", "context, as the model's metadata says")
    contexts = _levels(given) if model.manifest.context_kind is ContextKind.VISUAL else _indicators(given)
    if index is None:
        if len(contexts) not in (1, count):
            accepted = f"context_index, or one context, or {count}: one per push"
            raise InvalidRequestError.at("inputs context", f"{len(contexts)} contexts", accepted)
        one_each = np.arange(count, dtype=np.int64)
        return contexts, np.zeros(count, dtype=np.int64) if len(contexts) == 1 else one_each
    if len(index) != count:
        raise InvalidRequestError.at("inputs context_index", f"{len(index)} values", f"{count}: one per push")
    if index.min() < 0 or index.max() >= len(contexts):
        accepted = f"0 to {len(contexts) - 1}"
        raise InvalidRequestError.at("inputs context_index", "a place that context does not have", accepted)
    return contexts, index.astype(np.int64)


def _indicators(given: Array) -> FloatArray:
    """Indicators (g, 36), each of an object that can be."""
    contexts: FloatArray = given.astype(np.float32)
    for number, row in enumerate(contexts):
        _check_indicator(row.tobytes(), number)
    return contexts


def _check_indicator(row: bytes, number: int) -> None:
    try:
        _known(row)
    except InvalidRequestError:
        ObjectContext.from_indicator(np.frombuffer(row, np.float32).tolist(), f"inputs context[{number}]")


@lru_cache(maxsize=4096)
def _known(row: bytes) -> ObjectContext:
    """An object that is known to be one."""
    return ObjectContext.from_indicator(np.frombuffer(row, np.float32).tolist())


def _levels(given: Array) -> FloatArray:
    """Visual contexts (g, 1, 32, 32), rounded to 8 bits."""
    if given.min() < 0.0 or given.max() > 1.0:
        raise InvalidRequestError.at("inputs context", "a level outside [0, 1]", "0 (black) to 1 (white)")
    levels = np.floor(given.astype(np.float64) * 255.0 + 0.5).astype(np.float32)
    contexts: FloatArray = levels / np.float32(255.0)
    return contexts
