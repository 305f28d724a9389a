"""Bodies of supports: pushes of an object with their outcomes, from which a meta-learner knows the object."""

from typing import Annotated, Final

import numpy as np
from pydantic import BeforeValidator, Field

from service.pushing.contexts import MAX_SUPPORT, SupportContext
from service.pushing.poses import REACH_M
from service.schemas.body import Body, at_most
from service.schemas.shapes import listed

SUPPORT_EXAMPLE: Final = {
    "pushers": [[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708], [0.06, 0.05, -2.6]],
    "outcomes": [[0.022, 0.001, 0.03], [0.0, 0.021, -0.05], [-0.015, -0.012, 0.21]],
}
_COORDINATE: Final = {"type": "number", "minimum": -REACH_M, "maximum": REACH_M}
_Pose = Annotated[
    list[float],
    Field(
        min_length=3,
        max_length=3,
        fail_fast=True,
        json_schema_extra={"prefixItems": [_COORDINATE, _COORDINATE, {"type": "number"}]},
    ),
]
_ROWS: Final = Field(min_length=1, max_length=MAX_SUPPORT, fail_fast=True)
_Poses = Annotated[list[_Pose], _ROWS, BeforeValidator(listed), at_most(MAX_SUPPORT)]


class SupportBody(Body):
    """Support: 1 to 50 pushes of one object, each of 50 mm, with their outcomes."""

    pushers: Annotated[
        _Poses,
        Field(
            description="for each push x, y, angle in m, m, rad: the pose of the pusher's tip before it, in the object "
            "frame before that push. Angles are wrapped.",
            examples=[SUPPORT_EXAMPLE["pushers"]],
        ),
    ]
    outcomes: Annotated[
        _Poses,
        Field(
            description="for each push x, y, angle in m, m, rad: the object's pose after it, in the same frame. "
            "[0, 0, 0] is an object that did not move. As many as pushers.",
            examples=[SUPPORT_EXAMPLE["outcomes"]],
        ),
    ]

    def to_domain(self, where: str) -> SupportContext:
        """Return the support as a context.

        Raises:
            InvalidRequestError: see ``SupportContext.of``.
        """
        return SupportContext.of(np.array(self.pushers), np.array(self.outcomes), where)
