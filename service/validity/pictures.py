"""Pictures: the faults that a picture of an object may have, as warnings."""

from collections.abc import Sequence
from typing import Final

from service.model.tensors import ContextKind
from service.pushing.image_quality import QualityFlag
from service.turns import pause
from service.validity.codes import WarningCode
from service.validity.known_objects import Contexts, viewed_object

PICTURES: Final = {
    QualityFlag.BLANK: (
        WarningCode.IMAGE_BLANK,
        "no object stands out from the background: send a picture of one object that is brighter than the table",
    ),
    QualityFlag.CLIPPED: (
        WarningCode.IMAGE_CLIPPED,
        "the object touches the border of the picture: send one that shows all of it",
    ),
    QualityFlag.OFF_CENTRE: (
        WarningCode.IMAGE_OFF_CENTRE,
        "the object's middle is more than 12 mm from the middle of the picture, where the origin is: centre it",
    ),
    QualityFlag.SEVERAL_OBJECTS: (
        WarningCode.IMAGE_SEVERAL_OBJECTS,
        "more than one object stands out from the background: send a picture of one",
    ),
}
_PART: Final = 64  # views between two pauses


def flags_of(contexts: Contexts) -> Sequence[Sequence[QualityFlag]]:
    """Return the faults of the picture of each context, in their order, or an empty list without pictures."""
    if contexts.kind is not ContextKind.VISUAL:
        return contexts.flags
    flags = []
    for number, view in enumerate(contexts.tensors[0]):
        if number % _PART == 0:
            pause()
        flags.append(viewed_object(view.tobytes()).flags)
    return flags
