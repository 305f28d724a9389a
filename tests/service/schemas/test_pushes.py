"""Bodies of prediction requests: pusher poses and object poses as arrays, context indices and references."""

import json
import math
from typing import Any

import numpy as np
import pytest

from service.errors import CazslError, InvalidRequestError
from service.model.reference import ModelReference
from service.pushing.poses import into_object_frame
from service.schemas.body import parse_body, validate_body
from service.schemas.documents import parse_json
from service.schemas.pushes import BatchRequest, PredictRequest

ORIGIN = [0.0, 0.0, 0.0]
OBJECT = {"descriptor": "1a2b3c4a"}


def read_batch(content: bytes) -> BatchRequest:
    """Read a batch as its endpoint does."""
    return validate_body(BatchRequest, parse_json(content))


def batch(**fields: Any) -> BatchRequest:
    """Return a batch of these fields, read from JSON."""
    return read_batch(json.dumps(fields).encode())


def single(pusher: list[float], **fields: Any) -> PredictRequest:
    """Return a request for one push, read from JSON."""
    pose = dict(zip(("x", "y", "angle"), pusher, strict=True))
    return parse_body(PredictRequest, json.dumps({"pusher": pose, **fields}).encode())


@pytest.mark.parametrize("pose", [None, [0.4, 0.1, 1.57], [-0.2, 0.3, -9.0]], ids=["object frame", "world", "wrapped"])
def test_a_single_push_and_a_batch_of_one_have_the_same_arrays(pose: list[float] | None) -> None:
    """One push is read to the same poses, to the bit, as a batch with that push, in both frames."""
    pusher = [-0.075, 0.01, 7.0] if pose is None else [pose[0] - 0.07, pose[1], pose[2]]
    one = single(pusher, object_pose=None if pose is None else dict(zip(("x", "y", "angle"), pose, strict=True)))
    many = batch(pushers=[pusher], object_poses=None if pose is None else [pose])
    assert one.pusher_poses().tobytes() == many.pusher_poses().tobytes()
    frames = (one.object_frames(), many.object_frames())
    assert frames == (None, None) if pose is None else frames[0].tobytes() == frames[1].tobytes()  # type: ignore[union-attr]


def test_pusher_poses_in_the_world_are_changed_into_the_frame_of_their_object() -> None:
    """Pushers of a batch are seen from their own object, or from the one object of all."""
    pushers = np.array([[0.5, 0.1, 0.0], [0.3, 0.2, 1.0]])
    objects = np.array([[0.4, 0.1, 1.57], [0.3, 0.1, -1.0]])
    for poses in (objects, objects[:1]):
        found = batch(pushers=pushers.tolist(), object_poses=poses.tolist()).pusher_poses()
        assert found == pytest.approx(into_object_frame(pushers, poses))


def test_lengths_are_one_for_all_or_one_per_push() -> None:
    """Lengths that are left out are 50 mm, and one number counts for all pushes."""
    assert single(ORIGIN).lengths_m().tolist() == batch(pushers=[ORIGIN] * 3).lengths_m().tolist() == [0.05]
    assert parse_body(PredictRequest, b'{"pusher": {"x": 0, "y": 0, "angle": 0, "length": 0.1}}').lengths_m() == 0.1
    assert batch(pushers=[ORIGIN] * 3, lengths=0.1).lengths_m().tolist() == [0.1]
    assert batch(pushers=[ORIGIN] * 2, lengths=[0.1, 1]).lengths_m().tolist() == [0.1, 1.0]
    with pytest.raises(InvalidRequestError, match=r"^body\.lengths: received 2 lengths"):
        batch(pushers=[ORIGIN] * 3, lengths=[0.1, 0.2]).lengths_m()


@pytest.mark.parametrize("length", [0, -0.05, 1.01, "0.05", None, True, [], [0.05, 0.0], [[0.05]], [0.05] * 10_001])
def test_a_length_that_is_none_is_refused(length: Any) -> None:
    """Zero, negative and long pushes, and values that are no numbers, are refused by their field."""
    with pytest.raises(InvalidRequestError, match=r"^body\.lengths"):
        batch(pushers=[ORIGIN] * 2, lengths=length)


def test_pushers_of_shapes_may_be_farther_from_the_origin() -> None:
    """The frame of a shape is the caller's, so the reach of a pusher is a matter of the kind of context."""
    far = [5.0, 0.0, 0.0]
    assert single(far).pusher_poses(10.0).tolist() == batch(pushers=[far]).pusher_poses(10.0).tolist() == [far]
    for found in (single(far), batch(pushers=[far])):
        with pytest.raises(InvalidRequestError, match="received 5 m"):
            found.pusher_poses()


def test_rows_are_not_changed_when_poses_are_computed() -> None:
    """A request stays as it was sent, however often its poses are computed."""
    found = batch(pushers=[[0.1, 0.2, 7.0]], object_poses=[[0.1, 0.1, -9.0]])
    first = found.pusher_poses()
    assert (found.pusher_poses() == first).all()
    assert found.pushers.tolist() == [[0.1, 0.2, 7.0]]


@pytest.mark.parametrize("x", [1.0000001, -5.0])
def test_a_pusher_out_of_reach_is_refused_by_its_coordinate(x: float) -> None:
    """A pusher more than 1 m away along an axis is refused, by the coordinate of a push or the row of a batch."""
    for request, where in (
        (single([x, 0.0, 0.0]), "body.pusher.x"),
        (single([0.0, x, 0.0]), "body.pusher.y"),
        (batch(pushers=[ORIGIN, [0.0, x, 0.0]]), "body.pushers.1"),
        (single([0.0, 0.0, 0.0], object_pose={"x": x, "y": 0.0, "angle": 0.0}), "body.pusher.0"),
        (batch(pushers=[ORIGIN], object_poses=[[0.0, x, 0.0]]), "body.pushers.0"),
    ):
        with pytest.raises(InvalidRequestError) as caught:
            request.pusher_poses()
        assert [fault.where for fault in caught.value.faults] == [where]


def test_object_poses_are_one_or_one_per_push() -> None:
    """Another number of object poses is refused, and their angles are wrapped."""
    assert batch(pushers=[ORIGIN] * 3).object_frames() is None
    found = batch(pushers=[ORIGIN] * 3, object_poses=[[0.1, 0.2, 3.0 * math.pi]]).object_frames()
    assert found is not None
    assert found[0] == pytest.approx([0.1, 0.2, math.pi])
    with pytest.raises(InvalidRequestError) as caught:
        batch(pushers=[ORIGIN] * 3, object_poses=[ORIGIN] * 2).object_frames()
    (fault,) = caught.value.faults
    assert (fault.where, fault.received) == ("body.object_poses", "2 poses")


def test_context_indices_follow_from_contexts_and_index() -> None:
    """A batch without contexts has no indices, and one with contexts has an index per push."""
    assert batch(pushers=[ORIGIN]).context_indices() is None
    for fields, expected in (
        ({"contexts": [OBJECT]}, [0, 0]),
        ({"contexts": [OBJECT] * 2}, [0, 1]),
        ({"contexts": [OBJECT] * 3, "context_index": [2, 0]}, [2, 0]),
    ):
        index = batch(pushers=[ORIGIN] * 2, **fields).context_indices()
        assert index is not None
        assert index.tolist() == expected


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"context_index": [0, 0]}, "body.contexts"),
        ({"contexts": [OBJECT] * 3}, "body.contexts"),
        ({"contexts": [OBJECT], "context_index": [0]}, "body.context_index"),
        ({"contexts": [OBJECT], "context_index": [0, 1]}, "body.context_index.1"),
    ],
    ids=["no contexts", "three contexts", "too short", "beyond"],
)
def test_contexts_and_index_that_do_not_fit_the_pushes_are_refused(fields: dict[str, Any], where: str) -> None:
    """Contexts or indices that do not fit two pushes are refused by their field."""
    with pytest.raises(InvalidRequestError) as caught:
        batch(pushers=[ORIGIN] * 2, **fields).context_indices()
    assert [fault.where for fault in caught.value.faults] == [where]


def test_a_reference_is_parsed_and_refused_by_its_field() -> None:
    """A request names a model by reference, or none, and an invalid reference is refused with the field model."""
    assert single(ORIGIN).reference() is None
    assert single(ORIGIN, model="push-none@2").reference() == ModelReference("push-none", None, 2)
    with pytest.raises(InvalidRequestError) as caught:
        single(ORIGIN, model="../etc").reference()
    assert caught.value.faults[0].where == "body.model"


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"pushers": NaN}', b'{"pushers": [[1e999, 0, 0]]}', b"{}"])
def test_bytes_that_are_no_batch_are_an_error_of_the_tree(content: bytes) -> None:
    """Any bytes that are no batch are refused with an error that the client can act on."""
    with pytest.raises(CazslError):
        read_batch(content)
