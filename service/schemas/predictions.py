"""What the service answers: the bodies of answers and errors.

Every field carries its unit, an example and what it means; the OpenAPI document is made of these.
"""

from typing import Annotated, Literal

from pydantic import Field

from service.schemas.body import Body
from service.schemas.models import ModelVersionBody

Frame = Annotated[
    Literal["object", "world"],
    Field(
        description="of every pose in the answer: the object's pose before the push, or the world, when the request "
        "said where the object is in it",
        examples=["object"],
    ),
]


class MeanBody(Body):
    """Expected pose of the object after the push, in the frame of the answer."""

    x: Annotated[float, Field(description="in m", examples=[0.021])]
    y: Annotated[float, Field(description="in m", examples=[0.001])]
    angle: Annotated[float, Field(description="in rad, in (-pi, pi]", examples=[0.03])]


class StdBody(Body):
    """Standard deviation of that pose; in the object frame the three are independent."""

    x: Annotated[float, Field(gt=0, description="in m", examples=[0.002])]
    y: Annotated[float, Field(gt=0, description="in m", examples=[0.001])]
    angle: Annotated[float, Field(gt=0, description="in rad", examples=[0.02])]


class PredictResponse(Body):
    """A Gaussian over the object's pose after the push."""

    model: ModelVersionBody
    frame: Frame
    mean: MeanBody
    std: StdBody
    covariance: Annotated[
        list[list[float]] | None,
        Field(
            description="3 x 3, of x, y, angle in m and rad; in the world frame only, where x and y may go together",
            examples=[[[4e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]]],
        ),
    ] = None


class BatchResponse(Body):
    """A Gaussian over the object's pose after each push, in the order of the request."""

    model: ModelVersionBody
    frame: Frame
    mean: Annotated[
        list[list[float]],
        Field(
            description="x, y, angle in m, m, rad for each push, angle in (-pi, pi]", examples=[[[0.021, 0.001, 0.03]]]
        ),
    ]
    std: Annotated[
        list[list[float]],
        Field(description="standard deviations in m, m, rad for each push", examples=[[[0.002, 0.001, 0.02]]]),
    ]
    covariance: Annotated[
        list[list[list[float]]] | None,
        Field(
            description="3 x 3 for each push, of x, y, angle in m and rad; in the world frame only",
            examples=[[[[4e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]]]],
        ),
    ] = None
