"""Contexts of requests are encoded as tensors: descriptors, indicators, visual contexts and images."""

import base64

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.api.v1 import endpoints, object_contexts
from service.api.v1.object_contexts import MAX_SHAPES, encode_context, encode_contexts, is_light
from service.errors import InvalidRequestError
from service.model.tensors import ContextKind
from service.observability.timings import Timings, collect_timings
from service.pushing.contexts import ObjectContext
from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from service.schemas.contexts import IMAGE_EXAMPLE, ContextBody
from service.schemas.pushes import BatchRequest, PredictRequest, PusherBody
from service.transport.endpoints import Weight
from tests.service.api.v1.requests import answer, batch, fault

INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator().astype(int).tolist()
LEVELS = bytes(range(256)) * 4


def test_contexts_are_one_for_all_one_per_push_or_by_index(faked: TestClient) -> None:
    """One context for all pushes, one per push, and contexts by index give the same numbers."""
    rows = [[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]
    context = {"descriptor": "1a2b3c4a"}
    answers = [
        batch(faked, pushers=rows, contexts=[context]),
        batch(faked, pushers=rows, contexts=[context, {"indicator": INDICATOR}]),
        batch(faked, pushers=rows, contexts=[{"descriptor": "4a4a4a4a"}, context, context], context_index=[2, 1]),
    ]
    assert answers[0] == answers[1] == answers[2]
    assert [row[0] for row in answers[0]["mean"]] == pytest.approx([-0.01, -0.02])


def test_a_visual_context_is_base64_or_rows_of_numbers(faked: TestClient) -> None:
    """Base64 and rows of numbers are the same 1,024 levels, for one push and in a batch."""
    text = base64.b64encode(LEVELS).decode()
    numbers = [[level / 255 for level in LEVELS[row * 32 : row * 32 + 32]] for row in range(32)]
    pusher = {"x": 0.1, "y": 0.0, "angle": 0.0}
    by_text = answer(faked, "/v1/predict", {"pusher": pusher, "context": {"visual": text}})
    by_numbers = answer(faked, "/v1/predict", {"pusher": pusher, "context": {"visual": numbers}})
    assert by_text == by_numbers
    assert by_text["model"]["name"] == "push-visual"
    many = batch(faked, pushers=[[0.1, 0.0, 0.0]] * 2, contexts=[{"visual": text}, {"visual": numbers}])
    assert many["mean"] == [pytest.approx(list(by_text["mean"].values()))] * 2


VISUAL_FAULTS = {
    "not base64": ("%%%", "not base64"),
    "no padding": (base64.b64encode(LEVELS).decode().rstrip("="), "not base64"),
    "too few": (base64.b64encode(LEVELS[:-1]).decode(), "1023 bytes"),
    "31 rows": ([[0.0] * 32] * 31, "31 rows"),
    "a long row": ([[0.0] * 32] * 31 + [[0.0] * 33], "32 rows"),
    "brighter than white": ([[1.5] * 32] * 32, "outside"),
}


@pytest.mark.parametrize("name", VISUAL_FAULTS)
def test_a_visual_context_that_is_not_valid_is_refused(faked: TestClient, name: str) -> None:
    """The fault of a visual context names the field and describes the received value."""
    visual, received = VISUAL_FAULTS[name]
    body = {"pusher": {"x": 0.1, "y": 0.0, "angle": 0.0}, "context": {"visual": visual}}
    where, found = fault(faked.post("/v1/predict", json=body))
    assert where == "body.context.visual"
    assert received in found


def test_a_repeated_descriptor_is_encoded_once() -> None:
    """The batch has the tensor of each distinct descriptor, and the index names it for each push."""
    contexts = [ContextBody(descriptor=descriptor) for descriptor in ("1a2b3c4a", "4a4a4a4a", "1a2b3c4a")]
    found = encode_contexts(contexts, np.array([2, 1, 0, 2]))
    assert found.kind is ContextKind.INDICATOR
    assert found.index is not None
    assert (found.tensors[0].shape, found.index.tolist()) == ((2, 36), [0, 1, 0, 0])


def test_the_tensor_of_a_descriptor_is_cached_and_read_only() -> None:
    """Pushes with one descriptor share a tensor, so that a micro-batch has it once."""
    first, second = (encode_context(ContextBody(descriptor="1a2b3c4a")).tensors[0] for _ in range(2))
    assert first is second
    assert not first.flags.writeable


def test_no_context_has_no_tensor() -> None:
    """A push or a batch without contexts has kind none, and the field for errors."""
    assert (encode_context(None).kind, encode_context(None).where) == (ContextKind.NONE, "body.context")
    found = encode_contexts(None, None)
    assert (found.kind, found.tensors, found.index, found.where) == (ContextKind.NONE, (), None, "body.contexts")


def test_a_faulty_descriptor_names_its_field() -> None:
    """A descriptor that cannot be encoded is refused with the field of this request."""
    with pytest.raises(InvalidRequestError, match=r"^body\.context\.descriptor"):
        encode_context(ContextBody(descriptor="1a2b3c9a"))


def test_only_images_are_timed() -> None:
    """The decode phase has the images of a request, and no other context."""
    timings: Timings = []
    collect_timings(timings)
    encode_context(ContextBody(descriptor="1a2b3c4a"))
    encode_context(ContextBody(image=IMAGE_EXAMPLE))
    assert [phase for phase, _ in timings] == ["decode"]


SUPPORT = {"pushers": [[-0.08, 0.0, 0.0], [0.0, -0.08, 1.5]], "outcomes": [[0.02, 0.0, 0.1], [0.0, 0.02, 0.0]]}


def test_a_support_is_the_context_of_one_push_and_of_a_batch(faked: TestClient) -> None:
    """The model of supports answers, for one push and by index in a batch, in the event loop."""
    body = ContextBody.model_validate({"support": SUPPORT})
    assert is_light(body)
    assert [tensor.shape for tensor in encode_context(body).tensors] == [(1, 50, 3), (1, 50, 3), (1, 50)]
    pusher = {"x": 0.1, "y": 0.0, "angle": 0.0}
    one = answer(faked, "/v1/predict", {"pusher": pusher, "context": {"support": SUPPORT}})
    assert (one["model"]["name"], one["warnings"]) == ("push-anp", [])
    other = {"support": {"pushers": [[0.08, 0.0, 3.0]], "outcomes": [[0.0, 0.0, 0.0]]}}
    many = batch(faked, pushers=[[0.1, 0.0, 0.0]] * 2, contexts=[other, {"support": SUPPORT}], context_index=[1, 0])
    assert many["mean"][0] == pytest.approx(list(one["mean"].values()))
    assert many["mean"][1] != many["mean"][0]


@pytest.mark.parametrize(
    ("change", "where", "received"),
    [
        ({"outcomes": [[0.0, 0.0, 0.0]]}, "body.context.support.outcomes", "1 outcomes"),
        ({"pushers": [[-0.08, 0.0, 0.0], [0.0, 4.0, 0.0]]}, "body.context.support.pushers.1", "4 m"),
        ({"pushers": []}, "body.context.support.pushers", "0 values"),
        ({"pushers": [[0.0] * 3] * 51}, "body.context.support.pushers", "51 values"),
        ({"outcomes": [[0.0] * 3, [0.0] * 2]}, "body.context.support.outcomes.1", "2 values"),
        ({"outcomes": None}, "body.context.support.outcomes", "null"),
        ({"lengths": [0.05]}, "body.context.support", "the field lengths"),
    ],
)
def test_a_support_that_is_not_valid_names_its_row(
    faked: TestClient, change: dict[str, object], where: str, received: str
) -> None:
    """The fault of a support names the list and the row, and describes the received value."""
    body = {"pusher": {"x": 0.1, "y": 0.0, "angle": 0.0}, "context": {"support": {**SUPPORT, **change}}}
    assert fault(faked.post("/v1/predict", json=body)) == (where, received)


def square(number: int) -> ContextBody:
    """Return one of many different squares, which no other test sends."""
    side = 0.03 + number * 1e-6
    return ContextBody(outline=[[side, side], [-side, side], [-side, -side], [side, -side]], friction=0.777)


def test_a_shape_that_was_seen_has_the_same_tensors() -> None:
    """Pushes of one outline share tensors, so that a micro-batch has them once. A corner more makes another object."""
    first, second = (encode_context(square(1)) for _ in range(2))
    assert first.kind is ContextKind.SHAPE
    assert all(one is other for one, other in zip(first.tensors, second.tensors, strict=True))
    expected = ShapeContext(Outline.of(square(1).outline or []), friction=0.777).tensors()
    assert [tensor[0].tolist() for tensor in first.tensors] == [tensor.tolist() for tensor in expected]
    assert encode_context(square(2)).tensors[0] is not first.tensors[0]


def test_a_repeated_outline_is_encoded_once() -> None:
    """The batch has the tensors of each distinct shape, and the index names it for each push."""
    found = encode_contexts([square(1), square(3), square(1)], np.array([2, 1, 0, 2]))
    assert [tensor.shape for tensor in found.tensors] == [(2, 1, 32, 32), (2, 64, 2), (2, 37, 3), (2, 11)]
    assert found.index is not None
    assert found.index.tolist() == [0, 1, 0, 0]


def test_only_shapes_that_were_seen_are_encoded_in_the_event_loop() -> None:
    """A new outline goes to a thread with its push, alone and in a batch. Once it was seen, it does not."""
    new, pusher = square(4), PusherBody(x=-0.1, y=0.0, angle=0.0)
    assert not is_light(new)
    one = PredictRequest(pusher=pusher, context=new)
    many = BatchRequest(pushers=[[-0.1, 0.0, 0.0]], contexts=[ContextBody(descriptor="1a2b3c4a"), new])  # type: ignore[arg-type]
    assert endpoints.SINGLE.weigh(one) is Weight.HEAVY
    assert endpoints.BATCH.weigh(many) is Weight.HEAVY
    encode_context(new)
    assert endpoints.SINGLE.weigh(one) is Weight.SINGLE
    assert endpoints.BATCH.weigh(many) is Weight.LIGHT


def test_the_number_of_different_shapes_in_a_batch_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Repeated shapes do not count. One shape too many is refused before it is encoded, and threads pause for each."""
    monkeypatch.setattr(object_contexts, "MAX_SHAPES", 3)
    pauses: list[int] = []
    monkeypatch.setattr(object_contexts, "pause", lambda: pauses.append(1))
    few = [square(5), square(6), square(7)]
    assert encode_contexts(few * 3, np.arange(9)).count == 3
    assert len(pauses) == 9
    with pytest.raises(InvalidRequestError, match="more than 3 different shapes"):
        encode_contexts([*few, square(8)], np.arange(4))
    assert MAX_SHAPES == 1000
