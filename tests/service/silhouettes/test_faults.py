"""Faults of pictures: each refusal names its field, its code and a cure."""

import pytest

from service.errors import InvalidImageError
from service.silhouettes import faults


@pytest.mark.parametrize(
    ("error", "code", "cure"),
    [
        (faults.blank("body.image"), "(image_blank)", "differs from the table"),
        (faults.clipped("body.image"), "(image_clipped)", "some table around it"),
        (faults.several_objects("body.image", 3), "3 objects (image_several_objects)", "crop the picture"),
        (faults.unclear("body.image"), "no single silhouette", "a mask of it"),
    ],
)
def test_a_refusal_names_field_cause_and_cure(error: InvalidImageError, code: str, cure: str) -> None:
    """Every refusal is a 422 whose message starts with the field, and says the cause before the cure."""
    assert error.status == 422
    message = str(error)
    assert message.startswith("body.image: received ")
    assert 0 < message.index(code) < message.index(" accepted is ") < message.index(cure)
