"""Bodies of shapes: outlines, their details and keys, and shapes that are found in images."""

import base64
import io
import math
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw

from service.errors import InvalidImageError, InvalidRequestError
from service.pushing.shape_context import SHAPE_REACH_M, ShapeContext
from service.schemas.body import validate_body
from service.schemas.contexts import ContextBody
from service.schemas.shapes import L_EXAMPLE, OUTLINE_EXAMPLE, ShapeDetails, find_shape

BOX = {"outline": OUTLINE_EXAMPLE}


def box_picture(left: int = 100, top: int = 100, size: tuple[int, int] = (400, 300)) -> bytes:
    """Return a mask of a rectangle of 150 x 100 pixels as PNG."""
    image = Image.new("L", size)
    ImageDraw.Draw(image).rectangle((left, top, left + 149, top + 99), fill=255)
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def blank_picture() -> bytes:
    """Return a black picture as PNG."""
    buffer = io.BytesIO()
    Image.new("L", (64, 64)).save(buffer, "PNG")
    return buffer.getvalue()


def two_boxes() -> bytes:
    """Return a mask of a rectangle of 150 x 100 pixels and a small one, which is no speck, as PNG."""
    image = Image.new("L", (400, 300))
    draw = ImageDraw.Draw(image)
    draw.rectangle((100, 100, 249, 199), fill=255)
    draw.rectangle((330, 240, 350, 260), fill=255)
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def shape_of(body: dict[str, Any]) -> ShapeContext:
    """Return the shape of a context."""
    found = validate_body(ContextBody, body).to_domain("there")
    assert isinstance(found, ShapeContext)
    return found


def test_an_outline_with_its_details_becomes_a_shape() -> None:
    """Details that are left out are unknown, and lists of Python become the values of the domain."""
    plain = shape_of({"outline": L_EXAMPLE})
    assert (plain.centre_of_mass_m, plain.friction, plain.pusher_radius_m) == (None, None, None)
    known = shape_of({"outline": L_EXAMPLE, "centre_of_mass": [-0.02, -0.03], "friction": 0.3, "pusher_radius": 0.01})
    assert (known.centre_of_mass_m, known.friction, known.pusher_radius_m) == ((-0.02, -0.03), 0.3, 0.01)
    assert known.outline.corners.tolist() == L_EXAMPLE


def test_corners_may_be_an_array() -> None:
    """A client's array of corners is accepted in place of a list."""
    body = ContextBody(outline=np.array(OUTLINE_EXAMPLE))  # type: ignore[arg-type]
    assert body == ContextBody(outline=OUTLINE_EXAMPLE)


@pytest.mark.parametrize(
    ("body", "where", "received"),
    [
        ({"outline": OUTLINE_EXAMPLE[:2]}, "body.outline", "2 values"),
        ({"outline": [[0.0, 0.0]] * 513}, "body.outline", "513 values"),
        ({"outline": [[0.0, 0.0, 0.0], *OUTLINE_EXAMPLE]}, "body.outline.0", "3 values"),
        ({"outline": [[0.0, math.nan], *OUTLINE_EXAMPLE]}, "body.outline.0.1", "not finite"),
        ({"outline": [*OUTLINE_EXAMPLE, OUTLINE_EXAMPLE[0]]}, "there.outline.4", "the same point as corner 0"),
        ({"outline": [OUTLINE_EXAMPLE[i] for i in (0, 2, 1, 3)]}, "there.outline", "cross or touch"),
        ({"outline": [[60.0, 40.0], [-60.0, 40.0], [0.0, -40.0]]}, "there.outline", "millimetres"),
        ({"outline": [[20.0, 0.0], [20.1, 0.0], [20.0, 0.1]]}, "there.outline.0", "[20, 0]"),
        ({**BOX, "centre_of_mass": [0.07, 0.0]}, "there.centre_of_mass", "[0.07, 0]"),
        ({**BOX, "centre_of_mass": [0.0]}, "body.centre_of_mass", "1 values"),
        ({**BOX, "friction": 0.0}, "body.friction", "0"),
        ({**BOX, "pusher_radius": -0.005}, "body.pusher_radius", "-0.005"),
        ({**BOX, "metres_per_pixel": 0.001}, "there.metres_per_pixel", "a value beside outline"),
        ({**BOX, "descriptor": "1a2b3c4a"}, "there", "descriptor and outline"),
        ({"descriptor": "1a2b3c4a", "friction": 0.3}, "there.friction", "a value beside descriptor"),
        ({"image": "AAAA", "pusher_radius": 0.005}, "there.pusher_radius", "a value beside image"),
    ],
)
def test_an_invalid_shape_is_refused_by_its_field(body: dict[str, Any], where: str, received: str) -> None:
    """Each refusal names the field and describes the value."""
    with pytest.raises(InvalidRequestError) as caught:
        validate_body(ContextBody, body).to_domain("there")
    (fault,) = caught.value.faults
    assert fault.where == where
    assert received in fault.received


def test_the_key_of_a_shape_is_its_content() -> None:
    """Equal shapes have equal keys, and each corner and each detail makes another one."""
    bodies = [
        BOX,
        {"outline": [*OUTLINE_EXAMPLE[:3], [0.06, -0.041]]},
        {**BOX, "friction": 0.3},
        {**BOX, "pusher_radius": 0.3e-2},
        {**BOX, "centre_of_mass": [0.0, 0.0]},
    ]
    keys = [validate_body(ContextBody, body).key for body in bodies]
    assert None not in keys
    assert len(set(keys)) == len(bodies)
    assert validate_body(ContextBody, bodies[2]).key == keys[2]


def test_a_context_that_is_no_plain_shape_has_no_key() -> None:
    """Images and contexts with a fault are not cached."""
    for body in ({"image": "AAAA"}, {**BOX, "descriptor": "1a2b3c4a"}, {**BOX, "metres_per_pixel": 0.1}, {}):
        assert validate_body(ContextBody, body).key is None


def test_the_outline_in_an_image_is_in_the_frame_of_the_image() -> None:
    """A mask of 150 x 100 pixels, up and left of the middle, is in metres with x right and y up, to half a pixel."""
    found = find_shape(box_picture(left=50, top=25), ShapeDetails(metres_per_pixel=0.0005, friction=0.4), "body")
    low, high = found.shape.outline.corners.min(axis=0), found.shape.outline.corners.max(axis=0)
    assert low == pytest.approx([-0.075, 0.0125], abs=0.0003)
    assert high == pytest.approx([0.0, 0.0625], abs=0.0003)
    assert (found.width, found.height, found.shape.friction) == (400, 300, 0.4)
    same = shape_of({"image": base64.b64encode(box_picture(50, 25)).decode(), "metres_per_pixel": 0.0005})
    assert same.outline.corners.tolist() == found.shape.outline.corners.tolist()


def test_an_image_without_an_object_is_refused_by_its_field() -> None:
    """The refusal says that the picture is blank, in the field of the image."""
    buffer = io.BytesIO()
    Image.new("L", (200, 200), 90).save(buffer, "PNG")
    with pytest.raises(InvalidImageError, match=r"^body\.image: received a blank picture"):
        find_shape(buffer.getvalue(), ShapeDetails(metres_per_pixel=0.0005), "body")


def test_a_scale_that_makes_an_object_too_small_is_refused_by_its_field() -> None:
    """A scale in millimetres or per metre is refused with the scales that are possible."""
    with pytest.raises(InvalidRequestError, match=r"^body\.metres_per_pixel: .* across"):
        find_shape(box_picture(), ShapeDetails(metres_per_pixel=1e-6), "body")


def test_details_without_a_scale_are_refused() -> None:
    """An image whose scale is unknown has no friction, and one without details passes."""
    ShapeDetails().check_without_scale("body")
    with pytest.raises(InvalidRequestError, match=r"^body\.friction"):
        ShapeDetails(friction=0.3).check_without_scale("body")


def test_the_reach_of_a_frame_is_bounded() -> None:
    """Corners at the bound are accepted: float32 still has a micrometre there."""
    corners = [[x + SHAPE_REACH_M - 0.06, y] for x, y in OUTLINE_EXAMPLE]
    assert shape_of({"outline": corners}).outline.corners.max() == SHAPE_REACH_M


def test_a_pressure_is_part_of_the_shape_and_of_its_key() -> None:
    """Three numbers become the pressure of the shape, and two shapes that differ by it have different keys."""
    assert shape_of(BOX | {"pressure": [0.5, 0.0, -0.5]}).pressure == (0.5, 0.0, -0.5)
    keys = {validate_body(ContextBody, BOX | {"pressure": pressure}).key for pressure in (None, [0, 0, 0], [1, 0, 1])}
    assert len(keys) == 3


@pytest.mark.parametrize("pressure", [[1.0, 0.0], [0.0] * 4, [0.0, 0.0, 5.1], "rim", [True, 0, 0]])
def test_other_pressures_are_refused(pressure: object) -> None:
    """A pressure of another length, type or size is refused by its field."""
    with pytest.raises(InvalidRequestError, match="pressure"):
        shape_of(BOX | {"pressure": pressure})
