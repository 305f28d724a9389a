"""Codes of warnings, which are stable, and the warning itself."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from service.pushing.poses import DoubleArray

Angles = Sequence[tuple[str, Sequence[float] | DoubleArray]]
"""Angles as they were sent, before they were wrapped, by their field: one for all rows, or one per row."""


class WarningCode(StrEnum):
    """Code of a warning. The prediction is still made, but a robot should not rely on it."""

    NO_CONTACT = "no_contact"
    STARTS_INSIDE = "starts_inside"
    UNFAMILIAR_PUSH = "unfamiliar_push"
    UNFAMILIAR_OBJECT = "unfamiliar_object"
    IMAGE_BLANK = "image_blank"
    IMAGE_CLIPPED = "image_clipped"
    IMAGE_OFF_CENTRE = "image_off_centre"
    IMAGE_SEVERAL_OBJECTS = "image_several_objects"
    ANGLE_LOOKS_LIKE_DEGREES = "angle_looks_like_degrees"
    LITTLE_LEARNT = "little_learnt"
    MANY_OUTLIERS = "many_outliers"


MEANINGS: Final = {
    WarningCode.NO_CONTACT: "the pusher never touches the object, which stays where it is",
    WarningCode.STARTS_INSIDE: "the pusher's tip starts inside the object",
    WarningCode.UNFAMILIAR_PUSH: "start, aim or length are outside of the pushes that this version vouches for",
    WarningCode.UNFAMILIAR_OBJECT: "the object is unlike those that this version vouches for",
    WarningCode.IMAGE_BLANK: "no object stands out from the background of the picture",
    WarningCode.IMAGE_CLIPPED: "the object touches the border of the picture",
    WarningCode.IMAGE_OFF_CENTRE: "the object's middle is not the picture's",
    WarningCode.IMAGE_SEVERAL_OBJECTS: "the picture has more than one object",
    WarningCode.ANGLE_LOOKS_LIKE_DEGREES: "an angle is over 2 pi, and angles are in rad",
    WarningCode.LITTLE_LEARNT: "the pushes of a refinement tell little of the object's body",
    WarningCode.MANY_OUTLIERS: "no body explains many of the outcomes of a refinement",
}


@dataclass(frozen=True, slots=True)
class AnswerWarning:
    """A warning about some rows of an answer.

    Attributes:
        code: one of the stable codes.
        detail: a sentence with the values of the first of these rows.
        rows: the rows, in rising order, each once.
    """

    code: WarningCode
    detail: str
    rows: tuple[int, ...]
