"""Bodies of object contexts: descriptor, indicator, visual context or image, and their conversion to the domain."""

import base64
import binascii
import math
from typing import Annotated, Any, Final

import numpy as np
from pydantic import ConfigDict, Field

from service.errors import InvalidRequestError
from service.pushing.contexts import INDICATOR_LENGTH, SIDES, VISUAL_SIZE, ObjectContext, VisualContext
from service.pushing.image_quality import quality_flags, thumbnail_png
from service.pushing.images import decode, visual_context
from service.schemas.body import Body, at_most

INDICATOR_EXAMPLE: Final = ObjectContext.from_descriptor("1a2b3c4a").indicator().astype(int).tolist()
IMAGE_EXAMPLE: Final = (  # PNG: a grey square in the middle of 32 x 32 pixels
    "iVBORw0KGgoAAAANSUhEUgAAACAAAAAgCAAAAABWESUoAAAAIklEQVR42mNgGAUMDAwMjDBGA5oE"
    "jM9EyIRRBcNJwSiAAABMRQEgAJdlWQAAAABJRU5ErkJggg=="
)
# the visual context of that image, and its thumbnail
_VISUAL_EXAMPLE: Final = base64.b64encode(bytes(256) + (bytes(8) + b"\x80" * 16 + bytes(8)) * 16 + bytes(256)).decode()
_THUMBNAIL_EXAMPLE: Final = (
    "iVBORw0KGgoAAAANSUhEUgAAAQAAAAEACAAAAAB5Gfe6AAABRklEQVR4nO3QgQkAIAwEMXVyR3cIhUNIBmiPHwMAAAAA"
    "AAAAAAAAAAAAAAD43bw9sB9ElP/Xi4ifGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZ"
    "oA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmg"
    "DqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAO"
    "qBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA4A"
    "AAAAAAAAAAAAAAAAAAAAuHUAko8CAFqKhPgAAAAASUVORK5CYII="
)
_PIECE_LENGTH: Final = 1 << 18  # characters of base64: a multiple of four
_VISUAL_TEXT_LENGTH: Final = 4 * math.ceil(VISUAL_SIZE**2 / 3)
# Schemas of the OpenAPI document only. ``to_domain`` has the better error messages.
_DESCRIPTOR_SCHEMA: Final[dict[str, Any]] = {"pattern": f"^([134][abc]|2[abcBC]){{{SIDES}}}$"}
_INDICATOR_SCHEMA: Final[dict[str, Any]] = {
    "items": {"enum": [0, 1]},
    "contains": {"const": 1},
    "minContains": 2 * SIDES,
    "maxContains": 2 * SIDES,
}
_VISUAL_SCHEMA: Final[dict[str, Any]] = {  # keywords of texts do not apply to rows, nor those of rows to a text
    "contentEncoding": "base64",
    "pattern": f"^[A-Za-z0-9+/]{{{_VISUAL_TEXT_LENGTH - 2}}}==$",
    "minItems": VISUAL_SIZE,
    "maxItems": VISUAL_SIZE,
    "items": {"minItems": VISUAL_SIZE, "maxItems": VISUAL_SIZE, "items": {"minimum": 0, "maximum": 1}},
}


def _one_form(schema: dict[str, Any]) -> None:
    """Add to the schema that exactly one of the fields is given, and is not null."""
    schema["oneOf"] = [
        {"required": [form], "properties": {form: {"not": {"type": "null"}}}} for form in schema["properties"]
    ]


_LevelRow = Annotated[list[float], Field(fail_fast=True)]


class VisualContextBody(Body):
    """Visual context of an image, to be sent instead of it, a thumbnail, and the faults of the image."""

    visual: Annotated[
        str,
        Field(
            description="base64 of 1,024 grey levels, row by row: a value for the field visual of a context",
            examples=[_VISUAL_EXAMPLE],
        ),
    ]
    thumbnail_png: Annotated[
        str,
        Field(
            description="base64 of a PNG of 256 x 256 pixels that shows the visual context to a person",
            examples=[_THUMBNAIL_EXAMPLE],
        ),
    ]
    flags: Annotated[
        list[str],
        Field(
            description="faults of the image: blank, clipped, off_centre, several_objects. With any of them "
            "predictions may be poor.",
            examples=[[]],
        ),
    ]


class ContextBody(Body):
    """Object context in exactly one form: descriptor, indicator, visual or image."""

    model_config = ConfigDict(json_schema_extra=_one_form)

    descriptor: Annotated[
        str | None,
        Field(
            description="four sides, each a shape digit (1 concave, 2 triangular, 3 circular, 4 rectangular) and a "
            "weight letter (a none, b 60 g, c 150 g, or B 60 g, C 150 g in the second position of a triangle)",
            examples=["1a2b3c4a"],
            json_schema_extra=_DESCRIPTOR_SCHEMA,
        ),
    ] = None
    indicator: Annotated[
        list[float] | None,
        Field(
            min_length=INDICATOR_LENGTH,
            max_length=INDICATOR_LENGTH,
            description="36 zeros and ones: for each of four sides the shape one-hot (4), then the weight one-hot (5)",
            examples=[INDICATOR_EXAMPLE],
            json_schema_extra=_INDICATOR_SCHEMA,
        ),
        at_most(INDICATOR_LENGTH),
    ] = None
    visual: Annotated[
        str | list[_LevelRow] | None,
        Field(
            description="a visual context: base64 of 1,024 grey levels, row by row, or 32 rows of 32 numbers "
            "in [0, 1]. POST /v1/contexts makes one from an image.",
            examples=["AAAA" * (_VISUAL_TEXT_LENGTH // 4 - 1) + "AA=="],
            json_schema_extra=_VISUAL_SCHEMA,
        ),
        at_most(VISUAL_SIZE),
    ] = None
    image: Annotated[
        str | None,
        Field(
            description="base64 of a top-down view as PNG, JPEG or WebP, which is converted to the visual context. "
            "POST /v1/predict/image takes the file itself.",
            examples=[IMAGE_EXAMPLE],
            json_schema_extra={"contentEncoding": "base64"},
        ),
    ] = None

    @property
    def only_descriptor(self) -> str | None:
        """Return the descriptor if it is the only form given, else None. Its tensor can be cached."""
        others = (self.indicator, self.visual, self.image)
        return self.descriptor if others == (None, None, None) else None

    def to_domain(self, where: str = "body.context") -> ObjectContext | VisualContext:
        """Return the object context. Blocking if it is an image, which is decoded.

        Raises:
            InvalidRequestError: there is not exactly one form, or its value is not valid.
            ImageTooLargeError, UnsupportedImageError: see ``images.decode``.
        """
        forms = type(self).model_fields
        given = [name for name in forms if getattr(self, name) is not None]
        if len(given) != 1:
            received = " and ".join(given) or "no form"
            raise InvalidRequestError.at(where, received, f"exactly one of {', '.join(forms)}")
        if self.descriptor is not None:
            return ObjectContext.from_descriptor(self.descriptor, f"{where}.descriptor")
        if self.indicator is not None:
            return ObjectContext.from_indicator(self.indicator, f"{where}.indicator")
        if self.image is not None:
            return visual_context(decode(_decode_base64(self.image, f"{where}.image"), where=f"{where}.image"))
        if isinstance(self.visual, str):
            return VisualContext.from_bytes(_decode_base64(self.visual, f"{where}.visual"), f"{where}.visual")
        return VisualContext.from_bytes(_levels(self.visual or [], f"{where}.visual"), f"{where}.visual")


def describe_context(context: VisualContext) -> VisualContextBody:
    """Return the body of a visual context, with its thumbnail and its quality flags."""
    return VisualContextBody(
        visual=base64.b64encode(context.levels).decode(),
        thumbnail_png=base64.b64encode(thumbnail_png(context)).decode(),
        flags=[flag.value for flag in quality_flags(context)],
    )


def _decode_base64(text: str, where: str) -> bytes:
    """Decode base64, in pieces, because the decoder holds the interpreter lock: 75 ms for a picture of 8 MiB.

    Raises:
        InvalidRequestError: the text is not base64 with its padding.
    """
    try:
        pieces = [
            base64.b64decode(text[start : start + _PIECE_LENGTH], validate=True)
            for start in range(0, len(text), _PIECE_LENGTH)
        ]
        if any(len(piece) < _PIECE_LENGTH // 4 * 3 for piece in pieces[:-1]):
            raise ValueError("padding inside of the text")
    except (binascii.Error, ValueError) as error:
        received = f"a text of {len(text)} characters that is not base64"
        raise InvalidRequestError.at(where, received, "base64 with its padding (RFC 4648)") from error
    return b"".join(pieces)


def _levels(rows: list[list[float]], where: str) -> bytes:
    """Convert 32 rows of 32 numbers in [0, 1] to grey levels, one byte each.

    Raises:
        InvalidRequestError: the rows have another shape, or a number is outside [0, 1].
    """
    if len(rows) != VISUAL_SIZE or any(len(row) != VISUAL_SIZE for row in rows):
        received = f"{len(rows)} rows"
        raise InvalidRequestError.at(where, received, f"{VISUAL_SIZE} rows of {VISUAL_SIZE} numbers")
    grey = np.array(rows)
    if not (grey.min() >= 0.0 and grey.max() <= 1.0):
        raise InvalidRequestError.at(where, "a number outside [0, 1]", "0 (black) to 1 (white)")
    return np.floor(grey * 255.0 + 0.5).astype(np.uint8).tobytes()
