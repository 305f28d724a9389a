"""What a model version says of itself, and the names it goes by. Parse, render, check; no files are touched here.

``manifest.json`` is canonical: sorted keys, UTF-8, two-space indent, one newline at the end, a format number. Laws:
``Manifest.parse(m.render()) == m`` and, for every text that we rendered, ``Manifest.parse(t).render() == t``.
"""

import hashlib
import json
import re
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, Self

import pydantic
from pydantic import BaseModel, ConfigDict, Field

from service.contract import ContextKind
from service.errors import BrokenModelError, FieldFault, InvalidRequestError

FORMAT: Final = 1
MANIFEST_FILE: Final = "manifest.json"
MODEL_FILE: Final = "model.onnx"
CARD_FILE: Final = "card.md"
DEFAULT_ALIAS: Final = "champion"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_VERSION = re.compile(r"[1-9][0-9]{0,8}")
REFERENCE_SYNTAX: Final = "name, name@alias or name@version, of lower-case letters, digits, '-' and '_'"


def is_name(text: str) -> bool:
    """Whether this may name a model or an alias; a number is no alias."""
    return _NAME.fullmatch(text) is not None


def is_alias(text: str) -> bool:
    """Whether this may name an alias: a name that cannot be taken for a version."""
    return is_name(text) and not text.isdigit()


def parse_version(text: str) -> int | None:
    """A positive integer without leading zeros, or None."""
    return int(text) if _VERSION.fullmatch(text) else None


@dataclass(frozen=True, slots=True)
class ModelReference:
    """How a caller names a model: ``name``, ``name@alias`` or ``name@version``; ``name`` alone means its champion."""

    name: str
    alias: str | None
    version: int | None

    @classmethod
    def parse(cls, text: str, where: str = "model") -> Self:
        """Read a reference.

        Raises:
            InvalidRequestError: it is not one; the text is not repeated.
        """
        name, at, rest = text.partition("@")
        version = parse_version(rest)
        if is_name(name) and (not at or version is not None or is_alias(rest)):
            return cls(name, None if version is not None else (rest or DEFAULT_ALIAS), version)
        raise InvalidRequestError([FieldFault(where, f"a text of {len(text)} characters", REFERENCE_SYNTAX)])

    def __str__(self) -> str:
        return f"{self.name}@{self.alias if self.version is None else self.version}"


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class FileDigest(_Document):
    """Size and sha256 of one file of a version."""

    size: Annotated[int, Field(ge=0)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

    @classmethod
    def of(cls, content: bytes) -> Self:
        """The digest of these bytes."""
        return cls(size=len(content), sha256=hashlib.sha256(content).hexdigest())


class Tensor(_Document):
    """One input or output of the graph; a text in the shape is a free dimension."""

    name: str
    dtype: Literal["float32", "int64"]
    shape: list[int | str]
    units: list[str]


class SelfCheck(_Document):
    """An input with the output it must give, within an absolute tolerance in SI units."""

    inputs: dict[str, list[Any]]
    outputs: dict[str, list[Any]]
    tolerance: Annotated[float, Field(gt=0.0)]


class Normalisation(_Document):
    """The statistics that are inside the graph, for the record: SI units."""

    input_mean: list[float]
    input_std: list[float]
    output_mean: list[float]
    output_std: list[float]


class DataRecord(_Document):
    """What a model was trained and measured on."""

    source: str
    sha256: str
    split: str
    train_objects: int
    train_pushes: int
    held_out_objects: int
    held_out_pushes: int


class Measures(_Document):
    """Held-out figures of one set-up; RMSE, STD and NLL in normalised units, sharpness in SI."""

    rmse: float
    std: float
    distance_mm: float
    nll: float


class Calibration(_Document):
    """Share of held-out values inside the central intervals, and how wide the predicted Gaussians are."""

    method: str
    coverage_50: float
    coverage_90: float
    coverage_95: float
    sharpness: Annotated[list[float], Field(description="mean predicted std: m, m, rad")]


class Manifest(_Document):
    """Everything that is known of one version; ``name`` and ``version`` must be those of its folder."""

    format: Literal[1] = FORMAT
    name: str
    version: Annotated[int, Field(ge=1)]
    created: str
    method: str
    context_kind: ContextKind = Field(strict=False)
    inputs: list[Tensor]
    outputs: list[Tensor]
    normalisation: Normalisation
    image_convention: str | None
    recipe: dict[str, str | int | float | bool]
    data: DataRecord
    code_version: str
    metrics: dict[str, Measures]
    calibration: dict[str, Calibration]
    self_check: SelfCheck
    files: dict[str, FileDigest]

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Read a manifest.

        Raises:
            BrokenModelError: it is not one, or of a format this version does not know; says which field.
        """
        try:
            manifest = cls.model_validate_json(content)
        except pydantic.ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(str(part) for part in first["loc"]) or "document"
            raise BrokenModelError(f"{MANIFEST_FILE}: {where}: {first['msg']}") from error
        if set(manifest.files) != {MODEL_FILE, CARD_FILE}:
            raise BrokenModelError(f"{MANIFEST_FILE}: files: expected exactly {MODEL_FILE} and {CARD_FILE}")
        if manifest.inputs != list(expected_inputs(manifest.context_kind)) or manifest.outputs != list(OUTPUTS):
            raise BrokenModelError(f"{MANIFEST_FILE}: inputs, outputs: not the tensors of the contract")
        return manifest

    def render(self) -> bytes:
        """The canonical text."""
        document = self.model_dump(mode="json")
        return (json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


POSE_UNITS: Final = ["m", "m", "rad"]
PUSHER: Final = Tensor(name="pusher", dtype="float32", shape=["n", 3], units=POSE_UNITS)
INDICATOR: Final = Tensor(name="context", dtype="float32", shape=["g", 36], units=["1"])
CONTEXT_INDEX: Final = Tensor(name="context_index", dtype="int64", shape=["n"], units=["1"])
OUTPUTS: Final = (
    Tensor(name="mean", dtype="float32", shape=["n", 3], units=POSE_UNITS),
    Tensor(name="std", dtype="float32", shape=["n", 3], units=POSE_UNITS),
)


def expected_inputs(kind: ContextKind) -> tuple[Tensor, ...]:
    """The inputs that a graph of this context kind must have, in order."""
    return (PUSHER,) if kind is ContextKind.NONE else (PUSHER, INDICATOR, CONTEXT_INDEX)
