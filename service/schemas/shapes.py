"""Bodies of shapes: the outline of an object, what else is known of it, and the scale of an image that shows it."""

import itertools
import math
import struct
from dataclasses import dataclass
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BeforeValidator, Field

from service.errors import InvalidRequestError
from service.pushing.image_quality import QualityFlag
from service.pushing.images import decode_colour
from service.pushing.outlines import Outline
from service.pushing.shape_context import SHAPE_REACH_M, ShapeContext
from service.pushing.support import MOST_PRESSURE
from service.schemas.body import Body, at_most
from service.silhouettes.search import find_outline

OUTLINE_EXAMPLE: Final = [[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]]
L_EXAMPLE: Final = [[-0.05, -0.05], [0.05, -0.05], [0.05, -0.02], [-0.02, -0.02], [-0.02, 0.05], [-0.05, 0.05]]
_FINEST_DIGIT: Final = 3  # of a pixel
_Pressure = Annotated[float, Field(json_schema_extra={"minimum": -MOST_PRESSURE, "maximum": MOST_PRESSURE})]
ShapeKey = tuple[bytes, tuple[float, ...] | None, float | None, float | None, tuple[float, ...] | None, float]
"""Content of a shape: the bytes of its corners, centre of mass, friction, the pusher's radius, the pressure, and the
standard deviation of the centre of mass."""


def listed(found: Any) -> Any:
    """Return an array as a list. Clients have arrays of corners."""
    return found.tolist() if isinstance(found, np.ndarray) else found


Point = Annotated[
    list[Annotated[float, Field(json_schema_extra={"minimum": -SHAPE_REACH_M, "maximum": SHAPE_REACH_M})]],
    Field(min_length=2, max_length=2, fail_fast=True),
]


class ShapeDetails(Body):
    """Scale of an image, and properties of an object of any shape. Each may be unknown."""

    metres_per_pixel: Annotated[
        float | None,
        Field(
            ge=1e-6,
            le=0.1,
            description="scale of the image, in m per pixel. With it, the outline of the one object in the image is "
            "the context: its frame has the origin in the middle of the image, x to the right and y up.",
            examples=[0.0005],
        ),
    ] = None
    centre_of_mass: Annotated[
        Point | None,
        Field(
            description="[x, y] in m, in the frame of the outline. Default: unknown, the centroid of the outline.",
            examples=[[0.01, 0.0]],
        ),
        BeforeValidator(listed),
        at_most(2),
    ] = None
    friction: Annotated[
        float | None,
        Field(
            ge=0.01,
            le=2.0,
            description="coefficient of friction of pusher and object. Default: unknown, about 0.25.",
            examples=[0.25],
        ),
    ] = None
    pusher_radius: Annotated[
        float | None,
        Field(
            ge=0.0005,
            le=0.1,
            description="radius of the pusher's round tip, in m. Default: unknown, about 0.00475.",
            examples=[0.00475],
        ),
    ] = None
    pressure: Annotated[
        list[_Pressure] | None,
        Field(
            min_length=3,
            max_length=3,
            fail_fast=True,
            description="[xx, xy, yy]: the weight per area of the underside goes with exp(xx x^2 + 2 xy x y + yy y^2), "
            "x and y from the centroid over the object's size (root mean square distance of its area from there). "
            "[0, 0, 0] is even, [1, 0, 1] bears more at the rim, [-1, 0, -1] in the middle. Default: unknown, even. "
            "POST /v1/contexts/refine finds it.",
            examples=[[0.5, 0.0, 0.5]],
        ),
        BeforeValidator(listed),
        at_most(3),
    ] = None

    def check_without_scale(self, where: str) -> None:
        """Refuse properties of a shape beside an image without its scale.

        Raises:
            InvalidRequestError: there is one.
        """
        for name in DETAILS:
            if getattr(self, name) is not None:
                accepted = f"this field with {SCALE}, the scale of the image, beside it"
                raise InvalidRequestError.at(f"{where}.{name}", f"a value without {SCALE}", accepted)

    def shape(self, outline: Outline, where: str = "body.context") -> ShapeContext:
        """Return the shape context of an outline with these details.

        Raises:
            InvalidRequestError: the centre of mass lies outside of the box around the outline, or a number of the
                pressure is too large.
        """
        centre = self.centre_of_mass
        if centre is not None:
            low, high = outline.corners.min(axis=0), outline.corners.max(axis=0)
            if not ((low <= centre) & (centre <= high)).all():
                accepted = f"a point of the object, in metres: x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g}"
                raise InvalidRequestError.at(f"{where}.centre_of_mass", f"[{centre[0]:g}, {centre[1]:g}]", accepted)
        pressure = self.pressure
        if pressure is not None and max(map(abs, pressure)) > MOST_PRESSURE:
            accepted = f"three numbers of -{MOST_PRESSURE:g} to {MOST_PRESSURE:g}"
            raise InvalidRequestError.at(f"{where}.pressure", f"{max(pressure, key=abs):g}", accepted)
        return ShapeContext(
            outline,
            None if centre is None else (centre[0], centre[1]),
            self.friction,
            self.pusher_radius,
            None if pressure is None else (pressure[0], pressure[1], pressure[2]),
        )

    def shape_key(self, corners: list[list[float]], centre_std_m: float) -> ShapeKey:
        """Return the content of a shape, by which its tensors can be cached."""
        packed = struct.pack(f"{2 * len(corners)}d", *itertools.chain.from_iterable(corners))
        centre, pressure = (None if value is None else tuple(value) for value in (self.centre_of_mass, self.pressure))
        return packed, centre, self.friction, self.pusher_radius, pressure, centre_std_m


SCALE: Final = "metres_per_pixel"
DETAILS: Final = tuple(ShapeDetails.model_fields)


@dataclass(frozen=True, eq=False)
class FoundShape:
    """Shape that was found in an image.

    Attributes:
        shape: the object, in the frame of the image.
        details: the scale of the image and the properties that were sent with it.
        metres_per_pixel: that scale.
        width, height: of the image, upright, in pixels.
        flags: faults of the image in spite of which the outline was found.
    """

    shape: ShapeContext
    details: ShapeDetails
    metres_per_pixel: float
    width: int
    height: int
    flags: tuple[QualityFlag, ...]


def find_shape(image: bytes, details: ShapeDetails, where: str) -> FoundShape:
    """Return the object in an image file whose scale is known. Blocking: it decodes.

    Corners are rounded to a thousandth of a pixel, so that an outline in JSON is short.

    Args:
        image: a mask or a photograph, as PNG, JPEG or WebP.
        details: the scale, and other properties of the object.
        where: field that has the fields of the image and of the details, for errors.

    Raises:
        ImageTooLargeError, UnsupportedImageError: see ``images.decode``.
        InvalidImageError, InvalidRequestError: see ``silhouettes.find_outline`` and ``ShapeDetails.shape``.
    """
    fields = f"{where}.image", f"{where}.{SCALE}"
    scale = details.metres_per_pixel
    if scale is None:
        raise InvalidRequestError.at(fields[1], "no value", "the scale of the image, in m per pixel")
    picture = decode_colour(image, where=fields[0])
    found = find_outline(picture, scale, fields)
    corners = found.outline.corners.round(_FINEST_DIGIT - math.floor(math.log10(scale)))
    shape = details.shape(Outline.of(corners, fields[0]), where)
    return FoundShape(shape, details, scale, picture.width, picture.height, found.flags)


def read_outline(corners: list[list[float]], where: str) -> Outline:
    """Return a valid outline within reach of its origin.

    Raises:
        InvalidRequestError: see ``Outline.of``, or a corner is too far from the origin of its frame.
    """
    outline = Outline.of(corners, where)
    far = np.abs(np.array(corners)).max(axis=1) > SHAPE_REACH_M
    if far.any():
        corner = int(far.argmax())
        accepted = f"-{SHAPE_REACH_M:g} to {SHAPE_REACH_M:g} m: a frame whose origin is near the object"
        raise InvalidRequestError.at(f"{where}.{corner}", f"[{corners[corner][0]:g}, {corners[corner][1]:g}]", accepted)
    return outline
