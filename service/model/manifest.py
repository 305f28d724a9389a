"""What a model version says of itself, and the names it goes by. Parse, render, check; no files are touched here.

``manifest.json`` is canonical: sorted keys, UTF-8, two-space indent, one newline at the end, a format number. Laws:
``Manifest.parse(m.render()) == m`` and, for every text that we rendered, ``Manifest.parse(t).render() == t``.

Formats, each of which is read for ever:

1. as below, without a digest of its own;
2. carries ``sha256``, the digest of the canonical text without it: no bit of a manifest can change unseen.
"""

import hashlib
import json
import math
import re
from dataclasses import dataclass, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Final, Self, get_args, get_origin, get_type_hints

from service.errors import BrokenModelError
from service.model.canonical_json import canonical
from service.model.reference import is_name
from service.model.tensors import ContextKind, Tensor

FORMAT: Final = 2  # what is written
FORMATS: Final = (1, 2)  # what is read
_DIGEST_KEY: Final = "sha256"
_VERSION_LINE: Final = (
    b'\n  "version": '  # what the digest stands before; it cannot be part of a text, which has no line ends
)
MANIFEST_FILE: Final = "manifest.json"
MODEL_FILE: Final = "model.onnx"
CARD_FILE: Final = "card.md"
_LARGEST: Final = 2**63
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class FileDigest:
    """Size and sha256 of one file of a version."""

    size: int
    sha256: str

    @classmethod
    def of(cls, content: bytes) -> Self:
        """The digest of these bytes."""
        return cls(size=len(content), sha256=hashlib.sha256(content).hexdigest())


@dataclass(frozen=True)
class SelfCheck:
    """An input with the output it must give, within an absolute tolerance in SI units; rows are lists of numbers.

    A row of ``context`` is one object's indicator (36) or visual context (1,024, row by row).
    """

    pusher: list[list[float]]
    context: list[list[float]]
    context_index: list[int]
    mean: list[list[float]]
    std: list[list[float]]
    tolerance: float


@dataclass(frozen=True)
class NormalisationRecord:
    """The statistics that are inside the graph, for the record: SI units, three each."""

    input_mean: list[float]
    input_std: list[float]
    output_mean: list[float]
    output_std: list[float]


@dataclass(frozen=True)
class DataRecord:
    """What a model was trained and measured on."""

    source: str
    sha256: str
    split: str
    train_objects: int
    train_pushes: int
    held_out_objects: int
    held_out_pushes: int


@dataclass(frozen=True)
class Metrics:
    """Held-out figures of one set-up, in normalised units unless the name says otherwise."""

    rmse: float
    std: float
    distance_mm: float
    nll: float


@dataclass(frozen=True)
class Calibration:
    """Share of held-out values inside the central intervals; sharpness is the mean predicted std in m, m, rad."""

    method: str
    coverage_50: float
    coverage_90: float
    coverage_95: float
    sharpness: list[float]


@dataclass(frozen=True)
class Manifest:
    """Everything that is known of one version; ``name`` and ``version`` must be those of its folder."""

    name: str
    version: int
    created: str  # UTC, ISO 8601
    method: str
    context_kind: ContextKind
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    normalisation: NormalisationRecord
    image_convention: str | None
    recipe: dict[str, str | int | float | bool]
    data: DataRecord
    code_version: str
    metrics: dict[str, Metrics]
    calibration: dict[str, Calibration]
    self_check: SelfCheck
    files: dict[str, FileDigest]
    format: int = FORMAT

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Read a manifest.

        Raises:
            BrokenModelError: it is not one, or of a format this version does not know; says which field.
        """
        try:
            document = json.loads(content, parse_constant=_refuse_constant)
        except (ValueError, RecursionError) as error:
            raise BrokenModelError(f"{MANIFEST_FILE}: not a JSON document in UTF-8") from error
        if not isinstance(document, dict) or type(number := document.get("format")) is not int or number not in FORMATS:
            known = " and ".join(map(str, FORMATS))
            raise BrokenModelError(f"{MANIFEST_FILE}: format: this version reads formats {known} only")
        if number > 1:
            document.pop(_DIGEST_KEY, None)  # compared below, with everything else
        manifest: Self = _read(cls, document, "manifest")
        manifest._check()
        if number > 1 and not manifest._renders(content):
            raise BrokenModelError(f"{MANIFEST_FILE}: {_DIGEST_KEY}: not the text that was published")
        return manifest

    def _renders(self, content: bytes) -> bool:
        try:
            return self.render() == content
        except ValueError:  # half a character, which JSON can write and UTF-8 cannot
            return False

    def _check(self) -> None:
        """Check the form beyond types; ``registry.verification`` checks the tensors."""
        digests = self.files.values()
        faults = (
            (not is_name(self.name), "name: not a model name"),
            (self.version < 1, "version: expected 1 or more"),
            (set(self.files) != {MODEL_FILE, CARD_FILE}, f"files: expected exactly {MODEL_FILE} and {CARD_FILE}"),
            (any(not _SHA256.fullmatch(d.sha256) or d.size < 0 for d in digests), "files: not a size and a sha256"),
            (not 0.0 < self.self_check.tolerance < math.inf, "self_check.tolerance: expected more than 0"),
        )
        for wrong, message in faults:
            if wrong:
                raise BrokenModelError(f"{MANIFEST_FILE}: {message}")

    def render(self) -> bytes:
        """The canonical text, from format 2 on with its own digest."""
        text = canonical(self)
        if self.format == 1:
            return text
        digest = hashlib.sha256(text).hexdigest()
        before, version, after = text.partition(_VERSION_LINE)
        return b"".join((before, f'\n  "{_DIGEST_KEY}": "{digest}",'.encode(), version, after))


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")


def _read(kind: Any, value: Any, where: str) -> Any:
    """A JSON value as the annotated type: exact types, no field missing, none unknown, numbers finite."""
    if kind == _ROW and _is_row(value):  # most of a manifest
        return value
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, dict):
        hints = _hints(kind)
        if odd := value.keys() ^ hints.keys():
            raise BrokenModelError(f"{MANIFEST_FILE}: {where}: missing or unknown: {', '.join(sorted(odd)[:5])}")
        parts = {name: _read(hints[name], part, f"{where}.{name}") for name, part in value.items()}
        return kind(**parts)
    if origin in (list, tuple) and isinstance(value, list):
        return origin(_read(arguments[0], part, f"{where}[{place}]") for place, part in enumerate(value))
    if origin is dict and isinstance(value, dict):
        return {name: _read(arguments[1], part, f"{where}.{name}") for name, part in value.items()}
    if origin is UnionType and type(value) in arguments:
        return value
    if kind is ContextKind and value in list(ContextKind):
        return ContextKind(value)
    if kind is float and type(value) in (int, float) and -_LARGEST < value < _LARGEST:
        return float(value)
    if kind is int and type(value) is int and -_LARGEST < value < _LARGEST:
        return value
    if kind in (str, NoneType) and type(value) is kind:
        return value
    raise BrokenModelError(f"{MANIFEST_FILE}: {where}: expected {getattr(kind, '__name__', kind)}")


_ROW: Final = list[float]


def _is_row(value: object) -> bool:
    return (
        isinstance(value, list) and set(map(type, value)) == {float} and -_LARGEST < min(value) <= max(value) < _LARGEST
    )


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)
