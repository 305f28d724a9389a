"""Bodies of object contexts: descriptor, indicator, visual context, image, outline or support, and conversion."""

import base64
import binascii
import math
from dataclasses import replace
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field

from service.errors import InvalidRequestError
from service.pushing.contexts import (
    INDICATOR_LENGTH,
    SIDES,
    VISUAL_SIZE,
    ObjectContext,
    SupportContext,
    VisualContext,
)
from service.pushing.image_quality import QualityFlag
from service.pushing.images import decode, visual_context
from service.pushing.outlines import FEWEST_CORNERS, MOST_CORNERS
from service.pushing.shape_context import SURE, ShapeContext
from service.schemas.body import at_most
from service.schemas.posteriors import UNCERTAIN, PosteriorBody
from service.schemas.shapes import (
    DETAILS,
    OUTLINE_EXAMPLE,
    SCALE,
    Point,
    ShapeDetails,
    ShapeKey,
    find_shape,
    listed,
    read_outline,
)
from service.schemas.supports import SUPPORT_EXAMPLE, SupportBody

INDICATOR_EXAMPLE: Final = ObjectContext.from_descriptor("1a2b3c4a").indicator().astype(int).tolist()
IMAGE_EXAMPLE: Final = (  # PNG: a grey square in the middle of 32 x 32 pixels
    "iVBORw0KGgoAAAANSUhEUgAAACAAAAAgCAAAAABWESUoAAAAIklEQVR42mNgGAUMDAwMjDBGA5oE"
    "jM9EyIRRBcNJwSiAAABMRQEgAJdlWQAAAABJRU5ErkJggg=="
)
DomainContext = ObjectContext | VisualContext | ShapeContext | SupportContext
FORMS: Final = ("descriptor", "indicator", "visual", "image", "outline", "support")
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


_POSTERIOR: Final = "posterior"
_UNKNOWN: Final = (None,) * len(DETAILS)
_NULL: Final[dict[str, Any]] = {"type": "null"}
_GIVEN: Final[dict[str, Any]] = {"not": _NULL}


def _one_form(schema: dict[str, Any]) -> None:
    """Add to the schema that exactly one form is given, with no other details of a shape than the form has."""
    unknown: dict[str, Any] = dict.fromkeys((*FORMS, *DETAILS, _POSTERIOR), _NULL)
    rules = [unknown | {form: _GIVEN} for form in FORMS if form != "outline"]
    shape = {name: rule for name, rule in unknown.items() if name not in DETAILS}
    rules += [shape | {"outline": _GIVEN, SCALE: _NULL}, shape | {"image": _GIVEN, SCALE: _GIVEN}]
    rules.append(shape | {"outline": _GIVEN, SCALE: _NULL} | dict.fromkeys((*UNCERTAIN, _POSTERIOR), _GIVEN))
    schema["oneOf"] = [
        {"required": [name for name, rule in rule_of.items() if rule is _GIVEN], "properties": rule_of}
        for rule_of in rules
    ]


_LevelRow = Annotated[list[float], Field(fail_fast=True)]
ContextKey = str | ShapeKey


class ContextBody(ShapeDetails):
    """Object context in exactly one form: descriptor, indicator, visual, image, outline or support.

    An outline, or an image with ``metres_per_pixel``, is an object of any shape. It may come with what else is known.
    """

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
            description="base64 of a top-down view as PNG, JPEG or WebP, which is converted to the visual context, or "
            "with metres_per_pixel to an outline. POST /v1/predict/image takes the file itself.",
            examples=[IMAGE_EXAMPLE],
            json_schema_extra={"contentEncoding": "base64"},
        ),
    ] = None

    outline: Annotated[
        list[Point] | None,
        Field(
            min_length=FEWEST_CORNERS,
            max_length=MOST_CORNERS,
            fail_fast=True,
            description="corners [x, y] in m of a simple polygon around the object, clockwise or counter-clockwise, in "
            "a frame of any origin and orientation: it is the object frame. An object is 0.005 to 2 m across.",
            examples=[OUTLINE_EXAMPLE],
        ),
        BeforeValidator(listed),
        at_most(MOST_CORNERS),
    ] = None
    posterior: Annotated[
        PosteriorBody | None,
        Field(
            description="how sure centre_of_mass, friction and pressure are, as POST /v1/contexts/refine answers. It "
            "is the prior if more pushes refine the context. The centre of mass counts as unknown while its standard "
            "deviation is over a tenth of the object's size.",
            examples=[None],
        ),
    ] = None

    support: Annotated[
        SupportBody | None,
        Field(
            description="pushes of the object that were observed, for a model that learns an object from examples",
            examples=[SUPPORT_EXAMPLE],
        ),
    ] = None

    @property
    def key(self) -> ContextKey | None:
        """Return the content of a context whose tensors can be cached, else None: a descriptor, or an outline alone."""
        if self.indicator is not None or self.visual is not None or self.image is not None or self.support is not None:
            return None
        if self.outline is None:
            details = self.metres_per_pixel, self.centre_of_mass, self.friction, self.pusher_radius, self.pressure
            return self.descriptor if details == _UNKNOWN and self.posterior is None else None
        if self.descriptor is not None or self.metres_per_pixel is not None:
            return None
        if self.posterior is not None and self._lacks_mean():
            return None
        return self.shape_key(self.outline, 0.0 if self.posterior is None else self.posterior.centre_std())

    @property
    def is_shape(self) -> bool:
        """Return True for an outline, or an image with its scale."""
        return self.outline is not None or (self.image is not None and self.metres_per_pixel is not None)

    def to_domain(self, where: str = "body.context") -> DomainContext:
        """Return the object context. Blocking if it is an image, which is decoded.

        Raises:
            RequestError: see ``describe``.
        """
        return self.describe(where)[0]

    def describe(self, where: str = "body.context") -> tuple[DomainContext, tuple[QualityFlag, ...]]:
        """Return the object context, and the faults of the photograph in which its outline was found, if any.

        Raises:
            InvalidRequestError: there is not exactly one form, its value is not valid, or it has details that belong to
                a shape.
            ImageTooLargeError, UnsupportedImageError: see ``images.decode``.
        """
        given = [name for name in FORMS if getattr(self, name) is not None]
        if len(given) != 1:
            received = " and ".join(given) or "no form"
            raise InvalidRequestError.at(where, received, f"exactly one of {', '.join(FORMS)}")
        self._check_details(given[0], where)
        if self.outline is not None:
            shape = self.shape(read_outline(self.outline, f"{where}.outline"), where)
            if self.posterior is not None and self.posterior.centre_std() > SURE * shape.outline.size_m:
                shape = replace(shape, centre_is_sure=False)
            return shape, ()
        if self.support is not None:
            return self.support.to_domain(f"{where}.support"), ()
        if self.descriptor is not None:
            return ObjectContext.from_descriptor(self.descriptor, f"{where}.descriptor"), ()
        if self.indicator is not None:
            return ObjectContext.from_indicator(self.indicator, f"{where}.indicator"), ()
        if self.image is not None:
            image = _decode_base64(self.image, f"{where}.image")
            if self.metres_per_pixel is not None:
                found = find_shape(image, self, where)
                return found.shape, found.flags
            return visual_context(decode(image, where=f"{where}.image")), ()
        if isinstance(self.visual, str):
            return VisualContext.from_bytes(_decode_base64(self.visual, f"{where}.visual"), f"{where}.visual"), ()
        return VisualContext.from_bytes(_levels(self.visual or [], f"{where}.visual"), f"{where}.visual"), ()

    def _check_details(self, form: str, where: str) -> None:
        """Refuse details of a shape beside a form that is no shape."""
        for name in DETAILS:
            belongs = form == "image" if name == SCALE else self.is_shape
            if getattr(self, name) is not None and not belongs:
                beside = "an image" if name == SCALE else "an outline, or an image with metres_per_pixel"
                raise InvalidRequestError.at(f"{where}.{name}", f"a value beside {form}", f"this field beside {beside}")
        if self.posterior is not None and (form != "outline" or self._lacks_mean()):
            accepted = f"this field beside an outline with {', '.join(UNCERTAIN)}: its mean"
            raise InvalidRequestError.at(f"{where}.{_POSTERIOR}", "a value without its mean", accepted)

    def _lacks_mean(self) -> bool:
        return any(getattr(self, name) is None for name in UNCERTAIN)


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
