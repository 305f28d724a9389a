"""Manifest of a model version: the record that is published beside its graph and its card.

``manifest.json`` is canonical: sorted keys, UTF-8, an indent of two spaces, one newline at the end, a format number.
Two laws hold. ``Manifest.parse(m.render()) == m``, and ``Manifest.parse(t).render() == t`` for every text ``t`` that
``render`` wrote. This module reads and writes bytes, never files.

Every format that was published can be read for ever:

1. The fields below, without a digest of its own.
2. As format 1, with ``sha256``, the digest of the canonical text without it, so that every changed bit is found.
3. As format 2, with ``validity``, ``rivals``, and in ``calibration`` the scale of the deviations and the shares of
   joint regions. The graph has a third output, ``unfamiliarity``, if the manifest declares it. All are optional.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from typing import Annotated, Final, Self

from pydantic import AfterValidator, ConfigDict, FailFast, Field, TypeAdapter, ValidationError, with_config

from service.errors import BrokenModelError
from service.model.canonical_json import canonical
from service.model.reference import MAX_VERSION, NAME_PATTERN
from service.model.strict_json import check_text, read_json
from service.model.tensors import ContextKind, Tensor

FORMAT: Final = 3  # of every manifest that is written
FORMATS: Final = (1, 2, 3)  # of manifests that are read
MANIFEST_FILE: Final = "manifest.json"
MODEL_FILE: Final = "model.onnx"
CARD_FILE: Final = "card.md"
MAX_MANIFEST_BYTES: Final = 1 << 20
MAX_ENTRIES: Final = 1000  # of a recipe, and of the set-ups that were measured
MAX_SELF_CHECK_ROWS: Final = 256
_OPTIONAL_SINCE: Final = 3
_DIGEST_KEY: Final = "sha256"
_VERSION_LINE: Final = b'\n  "version": '  # follows the digest. No text contains it, because JSON escapes line ends.
_LARGEST: Final = 2**63
_MAX_FAULTS: Final = 5
_MESSAGES: Final = {
    "unexpected_keyword_argument": "unknown field",
    "missing": "the field is required",
    "value_error": "a text of one line without control characters is accepted",
}

Integer = Annotated[int, Field(gt=-_LARGEST, lt=_LARGEST)]
Number = Annotated[float, Field(gt=-float(_LARGEST), lt=float(_LARGEST))]
Row = Annotated[list[Number], FailFast()]  # a collection stops at its first fault, so a file of faults costs little
Rows = Annotated[list[Row], FailFast()]
Text = Annotated[str, AfterValidator(check_text)]  # one line
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


@dataclass(frozen=True)
class FileDigest:
    """Size in bytes and sha256 of one file of a version."""

    size: Annotated[Integer, Field(ge=0)]
    sha256: Sha256

    @classmethod
    def of(cls, content: bytes) -> Self:
        """Return the digest of these bytes."""
        return cls(size=len(content), sha256=hashlib.sha256(content).hexdigest())


@dataclass(frozen=True)
class SelfCheck:
    """Stored input and the output that belongs to it, within an absolute tolerance in SI units.

    A row of ``context`` is one object's tensors, flattened, one after the other in the order of the inputs: an
    indicator (36), a visual context (1,024, row by row), or a shape's tensors in their order.
    """

    pusher: Annotated[Rows, Field(max_length=MAX_SELF_CHECK_ROWS)]
    context: Rows
    context_index: Annotated[list[Integer], FailFast()]
    mean: Rows
    std: Rows
    tolerance: Annotated[Number, Field(gt=0.0)]


@dataclass(frozen=True)
class NormalisationRecord:
    """Statistics that are inside the graph, repeated for readers: three values each, in SI units."""

    input_mean: Row
    input_std: Row
    output_mean: Row
    output_std: Row


@dataclass(frozen=True)
class DataRecord:
    """Data that a model was trained and measured on."""

    source: Text
    sha256: Text
    split: Text
    train_objects: Integer
    train_pushes: Integer
    held_out_objects: Integer
    held_out_pushes: Integer


@dataclass(frozen=True)
class Metrics:
    """Held-out figures of one set-up, in normalised units unless the name says otherwise."""

    rmse: Number
    std: Number
    distance_mm: Number
    nll: Number


@dataclass(frozen=True)
class Calibration:
    """Share of held-out values inside the central intervals. Sharpness is the mean predicted std in m, m, rad.

    ``scale`` is the factor on every deviation that is inside the graph. ``regions`` are the shares of held-out outcomes
    inside the joint regions of all three outputs.
    """

    method: Text
    coverage_50: Number
    coverage_90: Number
    coverage_95: Number
    sharpness: Row
    scale: Number | None = None
    regions_50: Number | None = None
    regions_90: Number | None = None
    regions_95: Number | None = None


@dataclass(frozen=True)
class Validity:
    """Domain that a version vouches for: the lowest and highest value of each feature, named with its SI unit."""

    ranges: Annotated[dict[Text, tuple[Number, Number]], FailFast(), Field(max_length=MAX_ENTRIES)]
    note: Text


@dataclass(frozen=True)
class Rival:
    """Figures of another version on the held-out data of this one, so that promotion compares like with like."""

    metrics: Annotated[dict[Text, Metrics], FailFast(), Field(max_length=MAX_ENTRIES)]
    calibration: Annotated[dict[Text, Calibration], FailFast(), Field(max_length=MAX_ENTRIES)]


@dataclass(frozen=True)
class Manifest:
    """Record of one version. ``name`` and ``version`` must be those of its folder."""

    name: Annotated[str, Field(pattern=f"^{NAME_PATTERN}$")]
    version: Annotated[int, Field(ge=1, le=MAX_VERSION)]
    created: Text  # UTC, ISO 8601
    method: Text
    context_kind: ContextKind
    inputs: Annotated[tuple[Tensor, ...], FailFast()]
    outputs: Annotated[tuple[Tensor, ...], FailFast()]
    normalisation: NormalisationRecord
    image_convention: Text | None
    recipe: Annotated[dict[Text, Text | Integer | float | bool], FailFast(), Field(max_length=MAX_ENTRIES)]
    data: DataRecord
    code_version: Text
    metrics: Annotated[dict[Text, Metrics], FailFast(), Field(max_length=MAX_ENTRIES)]
    calibration: Annotated[dict[Text, Calibration], FailFast(), Field(max_length=MAX_ENTRIES)]
    self_check: SelfCheck
    files: Annotated[dict[str, FileDigest], FailFast()]
    format: Annotated[int, Field(ge=FORMATS[0], le=FORMATS[-1])] = FORMAT
    validity: Validity | None = None
    rivals: dict[Text, Rival] | None = None  # by the number of their version

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Read a manifest. ``registry.verification`` compares its tensors with those of the domain.

        Raises:
            BrokenModelError: the bytes are not a manifest, or of an unknown format. The message names the field.
        """
        document = _read(content)
        manifest = cls(**{field.name: getattr(document, field.name) for field in fields(cls)})
        if set(manifest.files) != {MODEL_FILE, CARD_FILE}:
            raise BrokenModelError(f"{MANIFEST_FILE}: files: expected exactly {MODEL_FILE} and {CARD_FILE}")
        if manifest.format < _OPTIONAL_SINCE and any(_optional_parts(manifest)):
            raise BrokenModelError(
                f"{MANIFEST_FILE}: format: {manifest.format} has no validity, rivals, scale or regions"
            )
        if document.sha256 != "" if manifest.format == 1 else manifest.render() != content:
            raise BrokenModelError(f"{MANIFEST_FILE}: {_DIGEST_KEY}: not the text that was published")
        return manifest

    def render(self) -> bytes:
        """Return the canonical text, from format 2 on with its own digest."""
        text = canonical(self)
        if self.format == 1:
            return text
        digest = hashlib.sha256(text).hexdigest()
        before, version, after = text.partition(_VERSION_LINE)
        return b"".join((before, f'\n  "{_DIGEST_KEY}": "{digest}",'.encode(), version, after))


@with_config(ConfigDict(strict=True, extra="forbid", allow_inf_nan=False))
@dataclass(frozen=True)
class _Document(Manifest):
    """Fields of the file: those of the manifest and, from format 2 on, its digest."""

    sha256: Sha256 = ""


@cache
def _reader() -> TypeAdapter[_Document]:
    """Return the reader of the file. It is built for the first manifest, because an import does no work."""
    return TypeAdapter(_Document)


def _read(content: bytes) -> _Document:
    """Read the fields: exact types, no field missing or unknown, none twice, numbers finite and below 2**63."""
    try:
        document = _reader().validate_json(content)
    except ValidationError as error:
        raise BrokenModelError(f"{MANIFEST_FILE}: {_fault(error)}") from error
    try:
        read_json(content, MAX_MANIFEST_BYTES)
    except ValueError as error:
        raise BrokenModelError(f"{MANIFEST_FILE}: {error}") from error
    return document


def _optional_parts(manifest: Manifest) -> Iterator[bool]:
    """Yield for each part that came with format 3 whether it is there."""
    yield manifest.validity is not None
    yield manifest.rivals is not None
    for found in manifest.calibration.values():
        yield any(part is not None for part in (found.scale, found.regions_50, found.regions_90, found.regions_95))


def _fault(error: ValidationError) -> str:
    """Return the first faults, or that of the format, because the format decides which fields there are."""
    found = error.errors(include_url=False, include_input=False)
    if found[0]["type"] == "json_invalid":
        return "not a JSON document in UTF-8"
    if any(fault["loc"] in ((), ("format",)) for fault in found):
        return f"format: this version reads formats {', '.join(map(str, FORMATS))} only"
    faults: dict[str, str] = {}
    for fault in found[:_MAX_FAULTS]:
        faults.setdefault(_place(fault["loc"]), _MESSAGES.get(fault["type"], fault["msg"]))
    return "; ".join(f"{place}: {message}" for place, message in faults.items())


def _place(parts: tuple[int | str, ...]) -> str:
    """Return the name of a field. Names that the file itself chose are repeated only if they can be shown."""
    parts = parts[:2] if parts[0] == "recipe" else parts  # the rest tells of the types that were tried
    return ".".join(text if len(text) <= 64 and text.isprintable() else "(name)" for text in map(str, parts))
