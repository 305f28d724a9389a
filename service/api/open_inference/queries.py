"""Queries of the Open Inference Protocol: tensors in, tensors out, with the models and the rules of ``/v1``.

A push that ``/v1`` refuses is refused here too: out of reach, or with a context that is not valid. Levels of a visual
context are rounded to 8 bits, as in ``/v1``. Parameters other than those of the binary extension are ignored.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np

from service.api.open_inference.bodies import InferRequestBody
from service.api.open_inference.wire import Array, read_inputs, read_json, render
from service.errors import InvalidRequestError
from service.inference.query import Answer, ContextBatch, Query
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.reference import ModelReference, parse_version
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import ObjectContext, index_contexts
from service.pushing.onnx_interface import OUTPUTS
from service.pushing.poses import REACH_M, wrap_angles

_OUTPUT_NAMES: Final = tuple(tensor.name for tensor in OUTPUTS)
_CONTEXTS: Final = "inputs context"
_CACHED_INDICATORS: Final = 4096
_LEVELS_AT_ONCE: Final = 256  # visual contexts rounded at once: their float64 takes 2 MiB


@dataclass(frozen=True, slots=True)
class InferRequest:
    """Inference request whose tensors are not read yet: the expected tensors depend on the model."""

    reference: ModelReference
    header_length: str | None
    content: bytes


@dataclass(frozen=True, slots=True)
class TensorQuery(Query):
    """A query whose answer is tensors."""

    wanted: Mapping[str, bool]  # for each output, in order, True for raw bytes
    id: str | None

    def encode(self, mean: FloatArray, std: FloatArray) -> Answer:
        """See ``Query.encode``."""
        name, version = self.model.manifest.name, self.model.manifest.version
        document: dict[str, Any] = {"model_name": name, "model_version": str(version)}
        if self.id is not None:
            document["id"] = self.id
        given = {"mean": mean, "std": std}
        outputs = {output: given[output] for output in self.wanted}
        binary = frozenset(output for output, is_binary in self.wanted.items() if is_binary)
        content, headers = render(document, outputs, binary)
        return Answer(content, name, version, len(mean), headers)


def parse_reference(model: str, version: str | None) -> ModelReference:
    """Return the reference to a model in a path.

    Raises:
        InvalidRequestError: name or version is not valid.
    """
    parsed = ModelReference.parse(model, "model")
    if version is None:
        return parsed
    number = parse_version(version)
    if number is None:
        raise InvalidRequestError.at("version", "a text that is not a version", "a positive integer")
    return ModelReference(parsed.name, None, number)


def ask_inference(models: Snapshot, request: InferRequest) -> TensorQuery:
    """Return the query of an inference request.

    Raises:
        RequestError: the model is not served, or a tensor or a push is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    model = models.find(request.reference)
    body, raw = read_json(request.content, request.header_length)
    wanted = _wanted_outputs(body)
    inputs = read_inputs(body, raw, model.manifest.inputs)
    pushers = _pushers(inputs.get("pusher"))
    return TensorQuery(model, pushers, _contexts(model, inputs, len(pushers)), wanted, body.id)


def _wanted_outputs(body: InferRequestBody) -> Mapping[str, bool]:
    """Return for each requested output, in order, True for raw bytes. Its own flag overrides that of the request."""
    every = (body.parameters or {}).get("binary_data_output") is True
    if not body.outputs:
        return dict.fromkeys(_OUTPUT_NAMES, every)
    wanted: dict[str, bool] = {}
    for output in body.outputs:
        if output.name not in _OUTPUT_NAMES or output.name in wanted:
            accepted = f"each of {', '.join(_OUTPUT_NAMES)} once"
            raise InvalidRequestError.at("outputs", "an unknown or repeated output", accepted)
        wanted[output.name] = (output.parameters or {}).get("binary_data", every) is True
    return wanted


def _pushers(given: Array | None) -> FloatArray:
    """Return pusher poses (n, 3) within reach, with wrapped angles."""
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


def _contexts(model: LoadedModel, inputs: Mapping[str, Array], pushes: int) -> ContextBatch:
    """Return the contexts and the index of each push's context."""
    kind = model.manifest.context_kind
    if kind is ContextKind.NONE:
        return ContextBatch(kind, None, None, _CONTEXTS)
    given = inputs.get("context")
    if given is None:
        raise InvalidRequestError.at("inputs", "no tensor context", "context, as the model's metadata says")
    tensor = _levels(given) if kind is ContextKind.VISUAL else _indicators(given)
    index = index_contexts(len(tensor), pushes, inputs.get("context_index"), (_CONTEXTS, "inputs context_index"))
    return ContextBatch(kind, tensor, index, _CONTEXTS)


def _indicators(given: Array) -> FloatArray:
    """Return indicators (g, 36), each checked to be valid."""
    contexts: FloatArray = given.astype(np.float32)
    for number, row in enumerate(contexts):
        _check_indicator(row.tobytes(), number)
    return contexts


def _check_indicator(row: bytes, number: int) -> None:
    try:
        _known(row)
    except InvalidRequestError:
        ObjectContext.from_indicator(np.frombuffer(row, np.float32).tolist(), f"{_CONTEXTS}[{number}]")


@lru_cache(maxsize=_CACHED_INDICATORS)
def _known(row: bytes) -> ObjectContext:
    """Return the object context of a valid indicator."""
    return ObjectContext.from_indicator(np.frombuffer(row, np.float32).tolist())


def _levels(given: Array) -> FloatArray:
    """Return visual contexts (g, 1, 32, 32), rounded to 8 bits."""
    if given.min() < 0.0 or given.max() > 1.0:
        raise InvalidRequestError.at(_CONTEXTS, "a level outside [0, 1]", "0 (black) to 1 (white)")
    contexts = np.empty(given.shape, dtype=np.float32)
    for start in range(0, len(given), _LEVELS_AT_ONCE):
        part = slice(start, start + _LEVELS_AT_ONCE)
        contexts[part] = np.floor(given[part].astype(np.float64) * 255.0 + 0.5)
    contexts /= np.float32(255.0)
    return contexts
