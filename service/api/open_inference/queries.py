"""Queries of the Open Inference Protocol: tensors in, tensors out, with the models and the rules of ``/v1``.

A push that ``/v1`` refuses is refused here too: out of reach, or with a context that is not valid. Levels of a visual
context are rounded to 8 bits, as in ``/v1``. Parameters other than those of the binary extension are ignored.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import orjson

from service.api.open_inference.bodies import InferRequestBody
from service.api.open_inference.contexts import read_contexts
from service.api.open_inference.wire import Array, read_inputs, read_json, render
from service.errors import InvalidRequestError
from service.inference.pushes import PushFields, push_rows, reach_m
from service.inference.query import Answer, Query, Warnings
from service.inference.snapshot import Snapshot
from service.model.manifest import Manifest
from service.model.reference import ModelReference, parse_version
from service.model.tensors import Gaussians
from service.pushing.poses import MAX_LENGTH_M, PUSH_LENGTH_M, DoubleArray, wrap_angles

_LENGTH: Final = 3  # column of a pusher with a length
_FIELDS: Final = PushFields("inputs pusher[{row}]", "inputs pusher[{row}, 3]")


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

    def encode(self, found: Gaussians, warnings: Warnings) -> Answer:
        """See ``Query.encode``."""
        name, version = self.model.manifest.name, self.model.manifest.version
        listed = orjson.dumps([asdict(warning) for warning in warnings]).decode()
        document: dict[str, Any] = {
            "model_name": name,
            "model_version": str(version),
            "parameters": {"warnings": listed},
        }
        if self.id is not None:
            document["id"] = self.id
        outputs = {output: getattr(found, output) for output in self.wanted}
        binary = frozenset(output for output, is_binary in self.wanted.items() if is_binary)
        content, headers = render(document, outputs, binary)
        return Answer(content, name, version, len(found.mean), headers)


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
    wanted = _wanted_outputs(body, model.manifest)
    inputs = read_inputs(body, raw, model.manifest.inputs)
    poses, lengths_m = _pushes(inputs.get("pusher"), model.manifest)
    angles = (("pusher", inputs["pusher"][:, 2].astype(np.float64)),)
    contexts = read_contexts(model.manifest, inputs, len(poses))
    rows = push_rows(model, poses, lengths_m, contexts, _FIELDS)
    return TensorQuery(model, rows, contexts, angles, wanted, body.id)


def _wanted_outputs(body: InferRequestBody, manifest: Manifest) -> Mapping[str, bool]:
    """Return for each requested output, in order, True for raw bytes. Its own flag overrides that of the request."""
    every = (body.parameters or {}).get("binary_data_output") is True
    names = tuple(tensor.name for tensor in manifest.outputs)
    if not body.outputs:
        return dict.fromkeys(names, every)
    wanted: dict[str, bool] = {}
    for output in body.outputs:
        if output.name not in names or output.name in wanted:
            accepted = f"each of {', '.join(names)} once"
            raise InvalidRequestError.at("outputs", "an unknown or repeated output", accepted)
        wanted[output.name] = (output.parameters or {}).get("binary_data", every) is True
    return wanted


def _pushes(given: Array | None, manifest: Manifest) -> tuple[DoubleArray, DoubleArray]:
    """Return poses (n, 3) within reach, with wrapped angles, and lengths (n,) or (1,) in m."""
    if given is None:
        columns = manifest.inputs[0].shape[1]
        raise InvalidRequestError.at("inputs", "no tensor pusher", f"pusher, FP32 [n, {columns}]")
    reach = reach_m(manifest.context_kind)
    far = np.abs(given[:, :2]) > reach
    if far.any():
        row = int(np.argwhere(far)[0][0])
        accepted = f"-{reach:g} to {reach:g} m along each of the object's axes"
        raise InvalidRequestError.at(f"inputs pusher[{row}]", "a push out of reach", accepted)
    pushes = given.astype(np.float64)
    pushes[:, 2] = wrap_angles(pushes[:, 2])
    lengths_m = pushes[:, _LENGTH] if pushes.shape[1] > _LENGTH else np.array([PUSH_LENGTH_M])
    outside = (lengths_m <= 0.0) | (lengths_m > MAX_LENGTH_M)
    if outside.any():
        row = int(outside.argmax())
        received, accepted = f"{lengths_m[row]:.6g} m", f"above 0, to {MAX_LENGTH_M:g} m"
        raise InvalidRequestError.at(_FIELDS.of_length(row), received, accepted)
    return pushes[:, :_LENGTH], lengths_m
