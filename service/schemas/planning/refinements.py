"""Bodies of refinements: a shape context with pushes and their outcomes, and the context with what they tell."""

from typing import Annotated, Final

import numpy as np
from pydantic import Field

from service.errors import InvalidRequestError
from service.planning.refine import MOST_PUSHES
from service.pushing.poses import WORLD_M, DoubleArray, into_object_frame, reachable
from service.pushing.shape_context import ShapeContext
from service.schemas.body import Body
from service.schemas.contexts import ContextBody
from service.schemas.models import ModelVersionBody
from service.schemas.posteriors import CORRELATION_EXAMPLE, STD_EXAMPLE
from service.schemas.predictions import BatchWarningBody
from service.schemas.pushes import PushColumns
from service.schemas.rows import Rows
from service.schemas.shapes import OUTLINE_EXAMPLE
from service.validity.codes import Angles

REFINED_EXAMPLE: Final = {
    "outline": OUTLINE_EXAMPLE,
    "centre_of_mass": [0.012, -0.003],
    "friction": 0.22,
    "pressure": [0.5, 0.0, 0.4],
    "posterior": {"std": STD_EXAMPLE, "correlation": CORRELATION_EXAMPLE},
}


class RefineRequest(PushColumns):
    """Request for the body of one object, from a few pushes of it with their outcomes."""

    context: Annotated[
        ContextBody,
        Field(
            description="the object, of any shape: an outline, or an image with metres_per_pixel. Centre of mass, "
            "friction and pressure are starting points, if they are sent. An answer with its posterior may come back "
            "with further pushes.",
            examples=[{"outline": OUTLINE_EXAMPLE}],
        ),
    ]
    outcomes: Annotated[
        Rows,
        Field(
            description="for each push x, y, angle in m, m, rad of the object after it: in its frame before that push, "
            "or in the world when object_poses is given",
            examples=[[[0.021, 0.001, 0.03], [0.002, 0.02, -0.1]]],
        ),
    ]
    object_poses: Annotated[
        Rows | None,
        Field(
            description="x, y, angle in m, m, rad of the object in the world before each push. If they are given, "
            "pusher poses and outcomes are in the world too.",
            examples=[[[0.4, 0.1, 1.57], [0.41, 0.12, 1.6]]],
        ),
    ] = None
    seed: Annotated[
        int,
        Field(ge=0, le=2**32 - 1, description="of the random numbers: the same gives the same answer", examples=[0]),
    ] = 0

    def check_count(self) -> None:
        """Refuse too many pushes, or a number of outcomes that is not theirs.

        Raises:
            InvalidRequestError: see above.
        """
        count = len(self.pushers)
        if count > MOST_PUSHES:
            raise InvalidRequestError.at("body.pushers", f"{count} pushes", f"1 to {MOST_PUSHES}")
        if len(self.outcomes) != count:
            accepted = f"{count}: one per push"
            raise InvalidRequestError.at("body.outcomes", f"{len(self.outcomes)} outcomes", accepted)

    def object_outcomes(self) -> DoubleArray:
        """Return the outcomes (n, 3) in the object frame before each push, their angles wrapped.

        Raises:
            InvalidRequestError: a coordinate is over ``WORLD_M``.
        """
        frames, outcomes = self.object_frames(), reachable(self.outcomes, "body.outcomes", WORLD_M)
        return outcomes if frames is None else into_object_frame(outcomes, frames)

    def sent_angles(self) -> Angles:
        """See ``PushColumns.sent_angles``. Outcomes have angles, too."""
        return (*super().sent_angles(), ("outcomes", self.outcomes[:, 2]))

    def prior_moments(self) -> tuple[DoubleArray, DoubleArray] | None:
        """Return standard deviations (6,) and correlation (6, 6) that the context has of earlier pushes, or None."""
        posterior = self.context.posterior
        return None if posterior is None else posterior.moments()


class RefineResponse(Body):
    """Refined context: the same object with the mean of the posterior, and the pushes that no body explains."""

    model: ModelVersionBody
    frame: Annotated[str, Field(description="frame of the context: object", examples=["object"])]
    context: Annotated[
        ContextBody,
        Field(
            description="a value for the field context of any request: the context that was sent, with centre_of_mass, "
            "friction, pressure and their posterior",
            examples=[REFINED_EXAMPLE],
        ),
    ]
    outliers: Annotated[
        list[int],
        Field(
            fail_fast=True,
            description="rows of the pushes whose outcomes no body explains, in rising order. They told nothing",
            examples=[[3]],
        ),
    ]
    warnings: Annotated[
        list[BatchWarningBody],
        Field(default_factory=list, fail_fast=True, description="of the pushes at ``rows``, from 0", examples=[[]]),
    ]


def refined_body(
    sent: ContextBody, found: ShapeContext, std: DoubleArray, correlation: DoubleArray, digits: int = 6
) -> ContextBody:
    """Return the body of a refined context.

    Args:
        sent: the context of the request.
        found: with the mean of the posterior.
        std: (6,) of the posterior.
        correlation: (6, 6) of the posterior.
        digits: of the correlations.
    """
    posterior = {
        "std": [float(f"{value:.{digits}g}") for value in std.tolist()],
        "correlation": np.clip(correlation, -1.0, 1.0).round(digits).tolist(),
    }
    return ContextBody.model_validate(
        {
            "outline": sent.outline or found.outline.corners.tolist(),
            "centre_of_mass": list(found.centre_of_mass_m or ()),
            "friction": found.friction,
            "pusher_radius": found.pusher_radius_m,
            "pressure": list(found.pressure or ()),
            "posterior": posterior,
        }
    )
