"""Bodies of push maps: pushes from all around an object, and how much each of them does."""

import math
from typing import Annotated, Final

from pydantic import Field

from service.errors import InvalidRequestError
from service.planning.push_map import USUAL_PLACES
from service.pushing.poses import MAX_LENGTH_M, PUSH_LENGTH_M
from service.schemas.body import Body, at_most
from service.schemas.contexts import ContextBody
from service.schemas.models import ModelVersionBody
from service.schemas.predictions import BatchWarningBody, Rows
from service.schemas.pushes import Prediction
from service.schemas.rows import MAX_PUSHES
from service.schemas.shapes import OUTLINE_EXAMPLE

MOST_ANGLES: Final = 64
USUAL_ANGLES_RAD: Final = (-0.5, 0.0, 0.5)
_STEEPEST_RAD: Final = math.pi / 2
Numbers = Annotated[list[float], Field(fail_fast=True)]


class PushMapRequest(Prediction):
    """Request for pushes from all around one object."""

    context: Annotated[
        ContextBody,
        Field(
            description="the object: an outline, an image with metres_per_pixel, a descriptor or an indicator",
            examples=[{"outline": OUTLINE_EXAMPLE}, {"descriptor": "1a2b3c4a"}],
        ),
    ]
    spacing: Annotated[
        float | None,
        Field(
            gt=0,
            le=10,
            description=f"distance between two places along the outline, in m. Default: {USUAL_PLACES} places in all. "
            f"Places times angles are at most {MAX_PUSHES}.",
            examples=[0.01],
        ),
    ] = None
    angles: Annotated[
        list[Annotated[float, Field(gt=-_STEEPEST_RAD, lt=_STEEPEST_RAD)]],
        Field(
            min_length=1,
            max_length=MOST_ANGLES,
            fail_fast=True,
            description="directions of the pushes from each place, from the inward normal, in rad, counter-clockwise",
            examples=[list(USUAL_ANGLES_RAD)],
        ),
        at_most(MOST_ANGLES),
    ] = list(USUAL_ANGLES_RAD)  # noqa: RUF012 (pydantic copies it)
    length: Annotated[
        float,
        Field(
            gt=0,
            le=MAX_LENGTH_M,
            description="length of every push, in m. Models of any shape know every length, others 0.05 only.",
            examples=[PUSH_LENGTH_M],
        ),
    ] = PUSH_LENGTH_M

    def places(self, perimeter_m: float) -> int:
        """Return the number of places along an outline of this length.

        Raises:
            InvalidRequestError: their pushes are too many.
        """
        if self.spacing is None:
            return USUAL_PLACES
        most = MAX_PUSHES // len(self.angles)
        least_m = perimeter_m / (most + 0.5)
        if self.spacing <= least_m:
            accepted = f"more than {least_m:.3g} m: up to {most} places with {len(self.angles)} angles"
            raise InvalidRequestError.at("body.spacing", f"{self.spacing:g} m", accepted)
        return max(1, round(perimeter_m / self.spacing))


class PushMapResponse(Body):
    """Push map of one object, in its frame. Every list has one value for each push."""

    model: ModelVersionBody
    frame: Annotated[str, Field(description="frame of every pose: object", examples=["object"])]
    pushers: Annotated[
        Rows,
        Field(description="x, y, angle of the tip before each push, in m, m, rad", examples=[[[-0.06, 0.0, 0.0]]]),
    ]
    points: Annotated[
        Rows, Field(description="x, y of the outline where each push starts, in m", examples=[[[-0.054, 0.0]]])
    ]
    length: Annotated[float, Field(description="length of every push, in m", examples=[PUSH_LENGTH_M])]
    mean: Annotated[
        Rows, Field(description="mean of x, y, angle after each push, in m, m, rad", examples=[[[0.049, 0.0, 0.01]]])
    ]
    std: Annotated[
        Rows, Field(description="standard deviations of them, in m, m, rad", examples=[[[0.002, 0.001, 0.02]]])
    ]
    contact: Annotated[
        list[bool], Field(fail_fast=True, description="whether each push touches the object", examples=[[True]])
    ]
    effectiveness: Annotated[
        Numbers,
        Field(
            description="how far the points of the object move, as root mean square, over the length of the push: 0 if "
            "it stays, and 1 if it moves as far as the tip",
            examples=[[0.98]],
        ),
    ]
    uncertainty: Annotated[
        Numbers,
        Field(
            description="standard deviation of where the points of the object end, as root mean square, in m",
            examples=[[0.002]],
        ),
    ]
    warnings: Annotated[
        list[BatchWarningBody],
        Field(default_factory=list, fail_fast=True, description="of the pushes at ``rows``, from 0", examples=[[]]),
    ]
