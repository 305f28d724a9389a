"""Bodies of contexts from images: the visual context, and the outline with its place in the picture."""

import base64

import numpy as np
import pytest

from service.pushing.contexts import VisualContext
from service.pushing.images import decode, visual_context
from service.schemas.contexts import IMAGE_EXAMPLE, ContextBody
from service.schemas.image_contexts import VisualContextBody, describe_context, describe_shape
from service.schemas.shapes import ShapeDetails, find_shape
from tests.service.schemas.test_shapes import box_picture


def test_the_body_of_a_visual_context_can_be_sent_as_a_context() -> None:
    """The described levels are a valid context, and the examples of the document are those of its example image."""
    context = visual_context(decode(base64.b64decode(IMAGE_EXAMPLE)))
    body = describe_context(context)
    assert ContextBody(visual=body.visual).to_domain() == context
    assert isinstance(context, VisualContext)
    for name, value in body:
        assert VisualContextBody.model_fields[name].examples == [value]


def test_the_outline_of_an_image_can_be_sent_again_and_drawn() -> None:
    """The context keeps its details and not the scale, and the pixels surround the rectangle of the picture."""
    details = ShapeDetails(metres_per_pixel=0.0005, friction=0.4, centre_of_mass=[0.0, 0.0])
    found = find_shape(box_picture(), details, "body")
    body = describe_shape(found)
    again = body.context.to_domain()
    assert again.tensors()[0].tobytes() == found.shape.tensors().silhouette.tobytes()  # type: ignore[union-attr]
    assert (body.context.friction, body.context.centre_of_mass, body.context.metres_per_pixel) == (0.4, [0, 0], None)
    pixels = np.array(body.outline_pixels)
    assert pixels.min(axis=0) == pytest.approx([100, 100], abs=0.6)
    assert pixels.max(axis=0) == pytest.approx([250, 200], abs=0.6)
    assert body.flags == []
