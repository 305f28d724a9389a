"""Bodies of contexts that an image became: to be sent instead of it, and to be looked at."""

import base64
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from service.pushing.contexts import VisualContext
from service.pushing.image_quality import quality_flags, thumbnail_png
from service.schemas.body import Body
from service.schemas.contexts import ContextBody
from service.schemas.shapes import DETAILS, SCALE, FoundShape

# the outline in the example image with 0.0005 m per pixel
_OUTLINE_EXAMPLE: Final = [
    [-0.004, -0.00375], [-0.00375, -0.004], [0.00375, -0.004], [0.004, -0.00375],
    [0.004, 0.00375], [0.00375, 0.004], [-0.00375, 0.004], [-0.004, 0.00375],
]  # fmt: skip
_PIXELS_EXAMPLE: Final = [
    [8.0, 23.5], [8.5, 24.0], [23.5, 24.0], [24.0, 23.5], [24.0, 8.5], [23.5, 8.0], [8.5, 8.0], [8.0, 8.5],
]  # fmt: skip
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


def describe_context(context: VisualContext) -> VisualContextBody:
    """Return the body of a visual context, with its thumbnail and its quality flags."""
    return VisualContextBody(
        visual=base64.b64encode(context.levels).decode(),
        thumbnail_png=base64.b64encode(thumbnail_png(context)).decode(),
        flags=[flag.value for flag in quality_flags(context)],
    )


class OutlineContextBody(Body):
    """Shape context of an image with its scale, to be sent instead of it, and its outline to draw over the image."""

    context: Annotated[
        ContextBody,
        Field(
            description="a value for the field context: the outline in m, in a frame with its origin in the middle of "
            "the image, x to the right and y up, with the properties that were sent",
            examples=[{"outline": _OUTLINE_EXAMPLE}],
        ),
    ]
    outline_pixels: Annotated[
        list[Annotated[list[float], Field(min_length=2, max_length=2, fail_fast=True)]],
        Field(
            fail_fast=True,
            description="the corners of the outline as [column, row] of the image, from its upper left corner",
            examples=[_PIXELS_EXAMPLE],
        ),
    ]
    flags: Annotated[
        list[str],
        Field(
            description="faults of the image in spite of which the outline was found: several_objects, if there are "
            "small ones beside it. With any of them predictions may be poor.",
            examples=[[]],
        ),
    ]


def describe_shape(found: FoundShape) -> OutlineContextBody:
    """Return the body of a shape context that was found in an image."""
    corners = found.shape.outline.corners
    pixels = corners / found.metres_per_pixel * (1.0, -1.0) + np.array((found.width, found.height)) / 2.0
    details = {name: getattr(found.details, name) for name in DETAILS if name != SCALE}
    return OutlineContextBody(
        context=ContextBody(outline=corners.tolist(), **details),
        outline_pixels=pixels.round(2).tolist(),
        flags=[flag.value for flag in found.flags],
    )
