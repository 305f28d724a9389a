"""Bodies of object contexts: each form as a context of the domain, and the description of an image."""

import base64
from typing import Any

import numpy as np
import pytest

from service.errors import InvalidImageError, InvalidRequestError
from service.pushing.contexts import VISUAL_SIZE, ObjectContext, VisualContext
from service.pushing.images import decode, visual_context
from service.schemas.contexts import IMAGE_EXAMPLE, INDICATOR_EXAMPLE, ContextBody

LEVELS = bytes(range(256)) * 4
TEXT = base64.b64encode(LEVELS).decode()
GREY = (np.frombuffer(LEVELS, dtype=np.uint8).reshape(VISUAL_SIZE, VISUAL_SIZE) / 255.0).tolist()
PICTURE = base64.b64decode(IMAGE_EXAMPLE)
PIECE_BYTES = (1 << 18) // 4 * 3  # of a text that is decoded at once


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ({"descriptor": "1a2b3c4a"}, ObjectContext.from_descriptor("1a2b3c4a")),
        ({"indicator": INDICATOR_EXAMPLE}, ObjectContext.from_descriptor("1a2b3c4a")),
        ({"visual": TEXT}, VisualContext(LEVELS)),
        ({"visual": GREY}, VisualContext(LEVELS)),
        ({"image": IMAGE_EXAMPLE}, visual_context(decode(PICTURE))),
        ({"descriptor": "1a2b3c4a", "image": None}, ObjectContext.from_descriptor("1a2b3c4a")),
    ],
    ids=["descriptor", "indicator", "base64", "rows", "image", "null beside it"],
)
def test_every_form_becomes_a_context(body: dict[str, Any], expected: ObjectContext | VisualContext) -> None:
    """Each form becomes a context of the domain, and a form that is null counts as absent."""
    assert ContextBody.model_validate(body).to_domain() == expected


@pytest.mark.parametrize("extra", [-2, -1, 0, 1, 2])
def test_a_long_image_is_decoded_in_pieces(extra: int) -> None:
    """Base64 of any length around the ends of two pieces is decoded, and padding inside of the text is refused."""
    content = PICTURE + bytes(2 * PIECE_BYTES + extra - len(PICTURE))
    text = base64.b64encode(content).decode()
    assert ContextBody(image=text).to_domain() == visual_context(decode(PICTURE))
    padded = base64.b64encode(content[: PIECE_BYTES - 1]).decode() + text[-8:]
    with pytest.raises(InvalidRequestError, match="not base64"):
        ContextBody(image=padded).to_domain()


@pytest.mark.parametrize(
    ("body", "where", "received"),
    [
        ({}, "there", "no form"),
        ({"descriptor": "1a2b3c4a", "visual": TEXT}, "there", "descriptor and visual"),
        ({"descriptor": "1a2b"}, "there.descriptor", "4 characters"),
        ({"indicator": [0.0] * 4 + INDICATOR_EXAMPLE[4:]}, "there.indicator side 1", "0 shapes"),
        ({"visual": "%" * 8}, "there.visual", "a text of 8 characters that is not base64"),
        ({"visual": TEXT.rstrip("=")}, "there.visual", f"a text of {len(TEXT) - 2} characters that is not base64"),
        ({"visual": base64.b64encode(LEVELS[1:]).decode()}, "there.visual", "1023 bytes"),
        ({"visual": []}, "there.visual", "0 rows"),
        ({"visual": GREY[:-1]}, "there.visual", "31 rows"),
        ({"visual": [*GREY[:-1], GREY[0][:-1]]}, "there.visual", "32 rows"),
        ({"visual": [*GREY[:-1], [1.001] * VISUAL_SIZE]}, "there.visual", "a number outside [0, 1]"),
        ({"image": "%"}, "there.image", "a text of 1 characters that is not base64"),
    ],
)
def test_an_invalid_form_is_refused_by_its_field(body: dict[str, Any], where: str, received: str) -> None:
    """A context without exactly one valid form is refused with its field and a description of the value."""
    with pytest.raises(InvalidRequestError) as caught:
        ContextBody.model_validate(body).to_domain("there")
    (fault,) = caught.value.faults
    assert (fault.where, fault.received) == (where, received)


def test_an_image_that_cannot_be_decoded_is_refused_by_its_field() -> None:
    """A truncated picture in a context is refused with the field image."""
    body = ContextBody(image=base64.b64encode(PICTURE[:-30]).decode())
    with pytest.raises(InvalidImageError, match=r"^body\.context\.image: received a PNG file"):
        body.to_domain()


def test_a_descriptor_alone_is_found_for_the_cache() -> None:
    """Only a context with a descriptor and no other field has it as its key."""
    assert ContextBody(descriptor="1a2b3c4a").key == "1a2b3c4a"
    assert ContextBody(indicator=INDICATOR_EXAMPLE).key is None
    assert ContextBody(descriptor="1a2b3c4a", visual=TEXT).key is None
    assert ContextBody(descriptor="1a2b3c4a", friction=0.3).key is None
