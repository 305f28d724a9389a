"""Queries of ``/v1``: batches, frames and references to models."""

import base64
import json
import math
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.pushing.contexts import ObjectContext
from service.schemas.predictions import BatchResponse, PredictResponse
from service.schemas.shapes import L_EXAMPLE, OUTLINE_EXAMPLE
from tests.service.api.v1.requests import answer, batch, fault, problem, single
from tests.service.schemas.test_shapes import blank_picture, box_picture, two_boxes

DESCRIPTORS = ("1a2b3c4a", "4a4a4a4a", "2B1c3a4b", "3c3a3a3b")
INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator().astype(int).tolist()
LEVELS = bytes(range(256)) * 4
BOX = {"outline": OUTLINE_EXAMPLE}
L = {"outline": L_EXAMPLE, "friction": 0.3}
PUSHER = {"x": -0.1, "y": 0.0, "angle": 0.0}
ROW = [-0.1, 0.0, 0.0]
SCALE = {"metres_per_pixel": "0.0005"}

pushers = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-7.0, 7.0)).map(list)
batches = st.lists(st.tuples(pushers, st.integers(0, len(DESCRIPTORS) - 1)), min_size=1, max_size=12)
no_reset = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)


@no_reset
@given(batches)
def test_a_row_does_not_depend_on_other_rows(shipped: TestClient, rows: list[tuple[list[float], int]]) -> None:
    """With the shipped model, each row of a mixed batch has the prediction that its push has alone.

    They differ by at most 2e-6, since matrix products of the runtime round differently by the size of the batch.
    """
    found = batch(
        shipped,
        pushers=[pusher for pusher, _ in rows],
        contexts=[{"descriptor": descriptor} for descriptor in DESCRIPTORS],
        context_index=[place for _, place in rows],
    )
    for number, (pusher, place) in enumerate(rows):
        alone = single(shipped, pusher, DESCRIPTORS[place])
        difference = np.array(found["mean"][number]) - list(alone["mean"].values())
        difference[2] = math.remainder(difference[2], 2 * math.pi)
        assert np.abs(difference).max() < 2e-6
        assert found["std"][number] == pytest.approx(list(alone["std"].values()), rel=1e-5)


@no_reset
@given(batches, st.integers(-1000, 1000))
def test_an_angle_is_circular_in_every_row(
    shipped: TestClient, rows: list[tuple[list[float], int]], turns: int
) -> None:
    """Whole turns of the pusher change a row by rounding only, and answered angles lie in (-pi, pi]."""
    here = [pusher for pusher, _ in rows]
    there = [[x, y, angle + turns * 2 * math.pi] for x, y, angle in here]
    contexts = [{"descriptor": DESCRIPTORS[place]} for _, place in rows]
    first, second = batch(shipped, pushers=here, contexts=contexts), batch(shipped, pushers=there, contexts=contexts)
    assert np.array(second["mean"])[:, :2] == pytest.approx(np.array(first["mean"])[:, :2], abs=1e-5)
    angles = np.array([first["mean"], second["mean"]])[:, :, 2]
    assert np.cos(angles[0] - angles[1]) == pytest.approx(1.0, abs=1e-6)
    assert (np.abs(angles) <= math.pi).all()


@no_reset
@given(pushers, st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-7, 7)))
def test_a_push_in_the_world_is_the_push_in_the_object_frame(
    shipped: TestClient, pusher: list[float], pose: tuple[float, float, float]
) -> None:
    """The prediction in the world is that of the object frame, moved and turned, with its covariance."""
    x, y, theta = pose
    cos, sin = math.cos(theta), math.sin(theta)
    world = [x + cos * pusher[0] - sin * pusher[1], y + sin * pusher[0] + cos * pusher[1], pusher[2] + theta]
    inside = single(shipped, pusher, "1a2b3c4a")
    body = {
        "pusher": dict(zip(("x", "y", "angle"), world, strict=True)),
        "context": {"descriptor": "1a2b3c4a"},
        "object_pose": {"x": x, "y": y, "angle": theta},
    }
    outside = answer(shipped, "/v1/predict", body)
    assert (inside["frame"], outside["frame"]) == ("object", "world")
    assert "covariance" not in inside
    mean, std = inside["mean"], inside["std"]
    assert outside["mean"]["x"] == pytest.approx(x + cos * mean["x"] - sin * mean["y"], abs=1e-5)
    assert outside["mean"]["y"] == pytest.approx(y + sin * mean["x"] + cos * mean["y"], abs=1e-5)
    assert math.cos(outside["mean"]["angle"] - mean["angle"] - theta) == pytest.approx(1.0, abs=1e-6)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    expected = turn @ np.diag(np.square(list(std.values()))) @ turn.T
    assert np.array(outside["covariance"]) == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert np.square(list(outside["std"].values())) == pytest.approx(np.diag(outside["covariance"]))


def test_a_batch_in_the_world_is_its_pushes_alone(shipped: TestClient) -> None:
    """A batch in the world has one object pose for all pushes, or one per push."""
    context, world = {"descriptor": "2B1c3a4b"}, [[0.4, 0.1, 1.5], [-3.0, 2.0, -0.4]]
    rows = [[0.4, 0.03, 1.4], [-3.05, 2.0, -0.2]]
    found = batch(shipped, pushers=rows, contexts=[context], object_poses=world)
    assert found["frame"] == "world"
    for number, (row, pose) in enumerate(zip(rows, world, strict=True)):
        names = ("x", "y", "angle")
        body = {
            "pusher": dict(zip(names, row, strict=True)),
            "context": context,
            "object_pose": dict(zip(names, pose, strict=True)),
        }
        alone = answer(shipped, "/v1/predict", body)
        assert found["mean"][number] == pytest.approx(list(alone["mean"].values()), abs=2e-6)
        assert np.array(found["covariance"][number]) == pytest.approx(np.array(alone["covariance"]), rel=1e-4)
    same = batch(shipped, pushers=rows[:1] * 3, contexts=[context], object_poses=world[:1])
    assert same["mean"] == [pytest.approx(found["mean"][0], abs=2e-6)] * 3


def test_ten_thousand_pushes_are_answered_and_one_more_is_refused(shipped: TestClient) -> None:
    """A batch may have 10,000 pushes, and not one more."""
    rows = [[-0.075, 0.0, 0.0]] * 10_000
    found = batch(shipped, pushers=rows, contexts=[{"descriptor": "1a2b3c4a"}])
    assert len(found["mean"]) == len(found["std"]) == 10_000
    assert found["model"]["name"] == "push-indicator"
    body = {"pushers": [*rows, rows[0]], "contexts": [{"descriptor": "1a2b3c4a"}]}
    assert fault(shipped.post("/v1/predict/batch", json=body))[0] == "body.pushers"


def test_a_batch_without_contexts_has_the_model_without_context(faked: TestClient) -> None:
    """Without contexts, the default model of a batch is that for pushes without context."""
    assert batch(faked, pushers=[[0.1, 0.0, 0.0]])["model"]["name"] == "push-none"


def test_a_batch_may_name_its_model(faked: TestClient) -> None:
    """Each batch names its own model, by name, version or alias."""
    for reference, name in (("push-none", "push-none"), ("push-none@1", "push-none")):
        assert batch(faked, pushers=[[0.1, 0.0, 0.0]], model=reference)["model"]["name"] == name
    contexts = [{"descriptor": "1a2b3c4a"}]
    assert batch(faked, pushers=[[0.1, 0, 0]], contexts=contexts, model="push-indicator@champion")


FAULTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "no rows": ({"pushers": []}, "body.pushers", "0 values"),
    "a short row": ({"pushers": [[0.0, 0.0, 0.0], [0.0, 0.0]]}, "body.pushers.1", "2 values"),
    "text in a row": ({"pushers": [[0.0, "0", 0.0]]}, "body.pushers.0.1", "a text of 1 characters"),
    "out of reach": ({"pushers": [[0.0, 0.0, 0.0], [0.0, -1.5, 0.0]]}, "body.pushers.1", "-1.5 m"),
    "no contexts": ({"contexts": []}, "body.contexts", "0 values"),
    "contexts that do not fit": (
        {"contexts": [{"descriptor": "4a4a4a4a"}] * 3},
        "body.contexts",
        "3 contexts",
    ),
    "a bad context": (
        {"contexts": [{"descriptor": "4a4a4a4a"}, {"descriptor": "4a4a4a4B"}]},
        "body.contexts.1.descriptor side 4",
        "weight B on shape 4",
    ),
    "two forms after a known one": (
        {"contexts": [{"descriptor": "4a4a4a4a"}, {"descriptor": "4a4a4a4a", "indicator": INDICATOR}]},
        "body.contexts.1",
        "descriptor and indicator",
    ),
    "two kinds": (
        {"contexts": [{"descriptor": "4a4a4a4a"}, {"visual": base64.b64encode(LEVELS).decode()}]},
        "body.contexts",
        "kind indicator at 0 and kind visual at 1",
    ),
    "a short index": ({"context_index": [0]}, "body.context_index", "1 values"),
    "an index beyond": ({"context_index": [0, 1]}, "body.context_index.1", "an index"),
    "an index before": ({"context_index": [-1, 0]}, "body.context_index.0", "an index"),
    "an index without contexts": ({"contexts": None, "context_index": [0, 0]}, "body.contexts", "no contexts"),
    "three poses": ({"object_poses": [[0, 0, 0]] * 3}, "body.object_poses", "3 poses"),
    "a pose out of the world": ({"object_poses": [[4e8, 0, 0]]}, "body.object_poses.0", "4e+08 m"),
    "out of reach in the world": ({"object_poses": [[5.0, 0, 0]]}, "body.pushers.0", "-5 m"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_a_batch_names_its_row(faked: TestClient, name: str) -> None:
    """A batch with a fault gets one fault that names the field and the row, even if other rows have faults."""
    body, where, received = FAULTS[name]
    in_order = {"pushers": [[0.0, 0.0, 0.0]] * 2, "contexts": [{"descriptor": "4a4a4a4a"}]}
    found = fault(faked.post("/v1/predict/batch", json=in_order | body))
    assert found[0] == where
    assert received in found[1]


def test_a_million_faults_cost_as_little_as_one(faked: TestClient) -> None:
    """A column stops at its first fault, and the answer has that fault only."""
    for column in (b'"pushers":', b'"pushers":[[0,0,0]],"contexts":', b'"pushers":[[0,0,0]],"context_index":'):
        content = b"{" + column + b"[" + b",".join([b"[null]"] * 1_000_000) + b"]}"
        response = faked.post("/v1/predict/batch", content=content, headers={"Content-Type": "application/json"})
        assert response.status_code == 422
        assert len(response.content) < 2000


def test_an_answer_has_the_documented_schema(shipped: TestClient) -> None:
    """The bytes of answers, which no schema writes, are valid by the documented schema."""
    rows = {"pushers": [[-0.075, 0.0, 0.0]], "contexts": [{"descriptor": "1a2b3c4a"}]}
    for extra in ({}, {"object_poses": [[0.0, 0.0, 0.0]]}):
        BatchResponse.model_validate_json(json.dumps(batch(shipped, **rows, **extra)))
    one = single(shipped, [-0.075, 0.0, 0.0], "1a2b3c4a")
    PredictResponse.model_validate_json(json.dumps(one))


def test_an_outline_is_answered_by_the_model_of_shapes(faked: TestClient) -> None:
    """One push and a batch of one agree, and the answer names the model and the frame."""
    one = answer(faked, "/v1/predict", {"pusher": {**PUSHER, "length": 0.02}, "context": L})
    assert one["model"]["name"] == "push-shape"
    assert one["frame"] == "object"
    many = batch(faked, pushers=[ROW], lengths=[0.02], contexts=[L])
    assert many["mean"] == [list(one["mean"].values())]


def test_objects_of_different_outlines_are_mixed_in_a_batch(faked: TestClient) -> None:
    """Contexts by index and one per push give the same rows, and each row is that of its own object."""
    by_index = batch(faked, pushers=[ROW] * 3, contexts=[BOX, L], context_index=[0, 1, 0])
    per_push = batch(faked, pushers=[ROW] * 3, contexts=[BOX, L, BOX])
    assert by_index == per_push
    assert by_index["mean"][0] == by_index["mean"][2] != by_index["mean"][1]


def test_the_frame_of_a_shape_is_the_callers(faked: TestClient) -> None:
    """Pushers far from the origin are accepted, and with a pose of the object all is in the world."""
    far = {"outline": [[x + 4.0, y] for x, y in OUTLINE_EXAMPLE]}
    found = answer(faked, "/v1/predict", {"pusher": {**PUSHER, "x": 3.9}, "context": far})
    assert found["mean"]["x"] == pytest.approx(-0.39)
    pose = {"x": 1.0, "y": 2.0, "angle": 0.0}
    pusher = {**PUSHER, "x": 4.9, "y": 2.0}
    world = answer(faked, "/v1/predict", {"pusher": pusher, "context": far, "object_pose": pose})
    assert world["frame"] == "world"
    assert world["mean"]["x"] == pytest.approx(1.0 - 0.39)


@pytest.mark.parametrize(
    ("body", "where", "received"),
    [
        ({"pusher": {**PUSHER, "x": 0.02}, "context": BOX}, "body.pusher", "starts inside"),
        ({"pusher": {**PUSHER, "x": 11.0}, "context": BOX}, "body.pusher.x", "11 m"),
        ({"pusher": {**PUSHER, "length": 0.0}, "context": BOX}, "body.pusher.length", "0"),
        ({"pusher": {**PUSHER, "length": 0.02}, "context": {"descriptor": "1a2b3c4a"}}, "body.pusher.length", "0.02 m"),
        ({"pusher": {**PUSHER, "length": 0.02}}, "body.pusher.length", "0.02 m"),
        ({"pusher": PUSHER, "context": {"outline": OUTLINE_EXAMPLE[::2]}}, "body.context.outline", "2 values"),
        ({"pusher": PUSHER, "context": {"outline": [[0, 0], [1, 1], [0, 1], [1, 0]]}}, "body.context.outline", "cross"),
    ],
)
def test_a_push_of_a_shape_that_is_not_valid_is_refused(
    faked: TestClient, body: dict[str, Any], where: str, received: str
) -> None:
    """The fault names the field and describes the value."""
    found = fault(faked.post("/v1/predict", json=body))
    assert found[0] == where
    assert received in found[1]


def test_the_first_push_that_starts_inside_is_named_by_its_row(faked: TestClient) -> None:
    """Of two pushes inside of their objects, the first is named, and only its own object counts."""
    body = {"pushers": [[0.03, 0.03, 0.0]] * 3, "contexts": [L, BOX], "context_index": [0, 1, 1]}
    assert fault(faked.post("/v1/predict/batch", json=body))[0] == "body.pushers.1"


def test_kinds_of_context_are_not_mixed(faked: TestClient) -> None:
    """A batch of an outline and a descriptor is refused, and so is an outline for another model."""
    mixed = {"pushers": [ROW] * 2, "contexts": [BOX, {"descriptor": "1a2b3c4a"}]}
    assert fault(faked.post("/v1/predict/batch", json=mixed))[1] == "kind shape at 0 and kind indicator at 1"
    other = {"pusher": PUSHER, "context": BOX, "model": "push-indicator"}
    problem(faked.post("/v1/predict", json=other), 422, "wrong_context_kind")


def test_an_image_with_its_scale_is_the_outline_that_contexts_returns(faked: TestClient) -> None:
    """Form, JSON, and the context of the image, sent again, give the same answer."""
    image, details = box_picture(), SCALE | {"friction": "0.2"}
    seen = faked.post("/v1/contexts", files={"image": image}, data=details)
    assert seen.status_code == 200, seen.text
    assert set(seen.json()) == {"context", "outline_pixels", "flags"}
    again = answer(faked, "/v1/predict", {"pusher": PUSHER, "context": seen.json()["context"]})
    form = faked.post(
        "/v1/predict/image", files={"image": image}, data=details | {"pusher": str(PUSHER).replace("'", '"')}
    )
    assert form.json() == again
    context = {"image": base64.b64encode(image).decode(), "metres_per_pixel": 0.0005, "friction": 0.2}
    assert answer(faked, "/v1/predict", {"pusher": PUSHER, "context": context}) == again
    many = {"pushers": str([ROW] * 2), "lengths": "[0.05, 0.02]"}
    found = faked.post("/v1/predict/image", files={"image": image}, data=details | many).json()
    assert found["mean"][0] == list(again["mean"].values())
    visual = faked.post("/v1/predict/image", files={"image": image}, data={"pushers": str([ROW])}).json()
    assert visual["model"]["name"] == "push-visual"


@pytest.mark.parametrize("path", ["/v1/contexts", "/v1/predict/image"])
def test_details_without_a_scale_or_not_valid_are_refused(faked: TestClient, path: str) -> None:
    """Friction needs the scale of the image, and a scale is a positive number."""
    pusher = {} if path == "/v1/contexts" else {"pushers": str([ROW])}
    for data, where in (({"friction": "0.3"}, "body.friction"), ({"metres_per_pixel": "0"}, "body.metres_per_pixel")):
        assert fault(faked.post(path, files={"image": box_picture()}, data=pusher | data))[0] == where


def test_a_push_that_can_be_relied_on_has_no_warnings(shipped: TestClient) -> None:
    """The list is there and empty, for one push and for a batch."""
    assert single(shipped, [-0.08, 0.0, 0.0], "1a2b3c4a")["warnings"] == []
    assert batch(shipped, pushers=[[-0.08, 0.0, 0.0]] * 2, contexts=[{"descriptor": "1a2b3c4a"}])["warnings"] == []


def test_warnings_of_a_batch_are_those_of_its_pushes_alone(shipped: TestClient) -> None:
    """A batch has each code once, with the rows whose single answers have it."""
    rows = [[-0.08, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.01, 0.0, 0.0], [-0.08, 0.0, 180.0]]
    found = batch(shipped, pushers=rows, contexts=[{"descriptor": "1a2b3c4a"}])["warnings"]
    of_batch = {warning["code"]: warning["rows"] for warning in found}
    assert len(of_batch) == len(found)
    alone = [{warning["code"] for warning in single(shipped, row, "1a2b3c4a")["warnings"]} for row in rows]
    assert alone[0] == set()
    assert {code: [row for row, codes in enumerate(alone) if code in codes] for code in of_batch} == of_batch
    assert set(of_batch) == set().union(*alone) >= {"no_contact", "starts_inside", "angle_looks_like_degrees"}


def test_a_photograph_with_several_objects_warns_in_every_form(faked: TestClient) -> None:
    """The flag of a picture comes with the prediction: of JSON, of a form, and of a batch with its rows."""
    image = two_boxes()
    form = faked.post("/v1/predict/image", files={"image": image}, data=SCALE | {"pusher": json.dumps(PUSHER)}).json()[
        "warnings"
    ]
    context = {"image": base64.b64encode(image).decode(), "metres_per_pixel": 0.0005}
    assert [warning["code"] for warning in form] == ["image_several_objects"]
    assert answer(faked, "/v1/predict", {"pusher": PUSHER, "context": context})["warnings"] == form
    (found,) = batch(faked, pushers=[ROW] * 3, contexts=[BOX, context], context_index=[0, 1, 1])["warnings"]
    assert (found["code"], found["rows"]) == ("image_several_objects", [1, 2])
    seen = faked.post("/v1/contexts", files={"image": image}, data=SCALE).json()
    assert seen["flags"] == ["several_objects"]
    many = faked.post("/v1/predict/image", files={"image": image}, data=SCALE | {"pushers": str([ROW] * 2)}).json()
    assert [(one["code"], one["rows"]) for one in many["warnings"]] == [("image_several_objects", [0, 1])]


def test_faults_of_an_image_without_a_scale_warn_in_every_form(shipped: TestClient) -> None:
    """A picture of nothing is flagged by contexts, and each prediction from it says that it is blank."""
    image = blank_picture()
    assert shipped.post("/v1/contexts", files={"image": image}).json()["flags"] == ["blank"]
    context = {"image": base64.b64encode(image).decode()}
    form = shipped.post("/v1/predict/image", files={"image": image}, data={"pusher": json.dumps(PUSHER)}).json()
    assert "image_blank" in {warning["code"] for warning in form["warnings"]}
    assert answer(shipped, "/v1/predict", {"pusher": PUSHER, "context": context})["warnings"] == form["warnings"]
    several = batch(shipped, pushers=[ROW] * 2, contexts=[context])["warnings"]
    assert [one["rows"] for one in several if one["code"] == "image_blank"] == [[0, 1]]


def test_half_a_turn_in_degrees_is_told(shipped: TestClient) -> None:
    """An angle of 180 looks like degrees, and one of pi does not."""
    for angle, expected in ((180.0, True), (3.1416, False)):
        codes = {warning["code"] for warning in single(shipped, [-0.08, 0.0, angle], "1a2b3c4a")["warnings"]}
        assert ("angle_looks_like_degrees" in codes) is expected


def test_a_picture_of_an_empty_table_warns(shipped: TestClient) -> None:
    """A view of nothing is answered with the warning that it is blank."""
    found = answer(shipped, "/v1/predict", {"pusher": PUSHER, "context": {"visual": [[0.1] * 32] * 32}})
    assert "image_blank" in {warning["code"] for warning in found["warnings"]}
