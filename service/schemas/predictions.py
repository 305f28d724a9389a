"""Bodies of predictions: a Gaussian over the object's pose after the push, for one push or for a batch."""

from typing import Annotated, Final, Literal

from pydantic import Field

from service.schemas.body import Body
from service.schemas.models import ModelVersionBody
from service.validity.codes import MEANINGS, WarningCode

# A client stops at the first fault of a wrong answer. To list all of them would take a thousand times its memory.
Rows = Annotated[list[Annotated[list[float], Field(fail_fast=True)]], Field(fail_fast=True)]
_MOST_WARNINGS: Final = 64  # more codes than there are, for later services
Frame = Annotated[
    Literal["object", "world"],
    Field(
        description="frame of every pose in the answer: object (the object's pose before the push), or world when the "
        "request gave the object's pose in the world",
        examples=["object"],
    ),
]


class MeanBody(Body):
    """Mean of the object's pose after the push, in the frame of the answer."""

    x: Annotated[float, Field(description="x of the mean, in m", examples=[0.021])]
    y: Annotated[float, Field(description="y of the mean, in m", examples=[0.001])]
    angle: Annotated[float, Field(description="angle of the mean, in rad, in (-pi, pi]", examples=[0.03])]


class StdBody(Body):
    """Standard deviations of that pose. In the object frame the three are independent."""

    x: Annotated[float, Field(gt=0, description="standard deviation of x, in m", examples=[0.002])]
    y: Annotated[float, Field(gt=0, description="standard deviation of y, in m", examples=[0.001])]
    angle: Annotated[float, Field(gt=0, description="standard deviation of the angle, in rad", examples=[0.02])]


class WarningBody(Body):
    """Warning about a prediction, which a robot should not rely on."""

    code: Annotated[
        str,
        Field(
            description="; ".join(f"{code}: {meaning}" for code, meaning in MEANINGS.items()),
            json_schema_extra={"enum": [code.value for code in WarningCode]},
            examples=["no_contact"],
        ),
    ]
    detail: Annotated[
        str,
        Field(
            description="the reason in words, with the values",
            examples=["the tip comes no nearer than 12 mm to the object on its way of 50 mm, so the object stays."],
        ),
    ]


class BatchWarningBody(WarningBody):
    """Warning about rows of a batch. A batch has each code at most once."""

    rows: Annotated[
        list[int],
        Field(
            fail_fast=True,
            description="every row that the warning is about, in rising order, from 0. The detail is that of the first",
            examples=[[0, 4]],
        ),
    ]


class PredictResponse(Body):
    """Prediction of one push: a Gaussian over the object's pose after the push."""

    model: ModelVersionBody
    frame: Frame
    mean: MeanBody
    std: StdBody
    covariance: Annotated[
        list[list[float]] | None,
        Field(
            description="3 x 3, of x, y, angle in m and rad. Only in the world frame, where x and y may be correlated.",
            examples=[[[4e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]]],
        ),
    ] = None
    warnings: Annotated[
        list[WarningBody],
        Field(
            default_factory=list,
            max_length=_MOST_WARNINGS,
            fail_fast=True,
            description="reasons not to rely on the prediction, none if empty",
            examples=[[]],
        ),
    ]


class BatchResponse(Body):
    """Predictions of a batch: a Gaussian over the object's pose after each push, in the order of the request."""

    model: ModelVersionBody
    frame: Frame
    mean: Annotated[
        Rows,
        Field(
            description="for each push the mean of x, y, angle in m, m, rad, the angle in (-pi, pi]",
            examples=[[[0.021, 0.001, 0.03]]],
        ),
    ]
    std: Annotated[
        Rows,
        Field(
            description="for each push the standard deviations of x, y, angle in m, m, rad",
            examples=[[[0.002, 0.001, 0.02]]],
        ),
    ]
    covariance: Annotated[
        Annotated[list[Rows], Field(fail_fast=True)] | None,
        Field(
            description="for each push 3 x 3, of x, y, angle in m and rad. Only in the world frame.",
            examples=[[[[4e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]]]],
        ),
    ] = None
    warnings: Annotated[
        list[BatchWarningBody],
        Field(
            default_factory=list,
            max_length=_MOST_WARNINGS,
            fail_fast=True,
            description="reasons not to rely on some rows, none if empty. At most one entry for each code, and each "
            "row at most once in it",
            examples=[[]],
        ),
    ]
