"""Bodies of refinements: frames, counts, and the context that goes back."""

from typing import Any

import numpy as np
import pytest

from service.errors import InvalidRequestError
from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from service.schemas.body import validate_body
from service.schemas.contexts import ContextBody
from service.schemas.planning.refinements import RefineRequest, refined_body
from service.schemas.shapes import OUTLINE_EXAMPLE

ONE = {"context": {"outline": OUTLINE_EXAMPLE}, "pushers": [[-0.1, 0.0, 0.0]], "outcomes": [[0.03, 0.0, 0.1]]}


def read(**fields: Any) -> RefineRequest:
    """Return a request."""
    return validate_body(RefineRequest, ONE | fields)


def use(fields: dict[str, Any]) -> None:
    """Read a request, and use each part of it."""
    request = read(**fields)
    request.check_count()
    request.lengths_m()
    request.object_frames()
    request.object_outcomes()


def test_outcomes_in_the_world_become_outcomes_in_the_object_frame() -> None:
    """A push along the world's y axis of an object that looks along it moves the object ahead."""
    request = read(
        object_poses=[[0.4, 0.1, np.pi / 2]], pushers=[[0.4, 0.0, np.pi / 2]], outcomes=[[0.4, 0.13, np.pi / 2 + 0.1]]
    )
    assert request.pusher_poses() == pytest.approx(np.array([[-0.1, 0.0, 0.0]]))
    assert request.object_outcomes() == pytest.approx(np.array([[0.03, 0.0, 0.1]]))
    assert read().object_outcomes() == pytest.approx(np.array([[0.03, 0.0, 0.1]]))


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"pushers": [[-0.1, 0.0, 0.0]] * 51, "outcomes": [[0.03, 0.0, 0.1]] * 51}, "body.pushers"),
        ({"outcomes": [[0.03, 0.0, 0.1]] * 2}, "body.outcomes"),
        ({"pushers": []}, "body.pushers"),
        ({"outcomes": [[0.0, 0.0]]}, "body.outcomes"),
        ({"outcomes": [[1e7, 0.0, 0.0]]}, "body.outcomes"),
        ({"outcomes": None}, "body.outcomes"),
        ({"context": None}, "body.context"),
        ({"lengths": [0.05, 0.05]}, "body.lengths"),
        ({"lengths": -0.05}, "body.lengths"),
        ({"seed": -1}, "body.seed"),
        ({"object_poses": [[0.0, 0.0, 0.0]] * 2}, "body.object_poses"),
        ({"priors": {}}, "body"),
    ],
)
def test_requests_that_do_not_fit_are_refused(fields: dict[str, Any], where: str) -> None:
    """Counts, ranges and types are refused with their field."""
    with pytest.raises(InvalidRequestError, match=where):
        use(fields)


def test_all_angles_of_a_request_are_judged() -> None:
    """Outcomes may be in degrees, too."""
    assert [name for name, _ in read().sent_angles()] == ["pushers", "outcomes"]


def test_the_refined_body_is_the_same_object_and_can_come_back() -> None:
    """The outline is sent back as it came, and the answer is a valid context with a posterior."""
    sent = ContextBody(outline=OUTLINE_EXAMPLE, pusher_radius=0.006)
    found = ShapeContext(Outline.of(OUTLINE_EXAMPLE), (0.01, 0.0), 0.25, 0.006, (0.5, 0.1, 0.4))
    body = refined_body(sent, found, np.full(6, 1.0 / 3.0), np.eye(6) * (1.0 + 1e-12))
    assert body.outline == OUTLINE_EXAMPLE
    assert (body.centre_of_mass, body.friction, body.pusher_radius) == ([0.01, 0.0], 0.25, 0.006)
    again = validate_body(ContextBody, body.model_dump(exclude_none=True))
    assert again.posterior is not None
    assert again.posterior.std == [0.333333] * 6
    assert isinstance(again.to_domain(), ShapeContext)
