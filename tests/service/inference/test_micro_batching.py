"""Single pushes of one turn of the event loop: one call of the runtime, and each gets its own answer."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from service.api.v1.queries import ask_single
from service.errors import ContextKindError, PredictionError
from service.inference.micro_batching import MAX_PUSHES_PER_CALL, MicroBatcher
from service.inference.query import Answer
from service.inference.snapshot import Snapshot
from service.model.tensors import ContextKind
from service.observability.timings import Timings, collect_timings
from service.schemas.pushes import PredictRequest
from tests.fakes import CHECKED_PUSH, FAILING, FakePredictor, fake_models, publish_fake


@pytest.fixture
def models(tmp_path: Path) -> Snapshot:
    """Fakes of every kind, and one that fails but for the push of its self-check."""
    registry, found = fake_models(tmp_path / "models")
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    publish_fake(registry, "push-failing", ContextKind.NONE, model=FAILING)
    found.refresh()
    return found.snapshot


def request(number: int = 0, **body: Any) -> PredictRequest:
    """A push of its own."""
    pusher = {"x": -0.08 + 0.001 * (number % 100), "y": 0.001 * (number // 100), "angle": 0.0}
    return PredictRequest.model_validate({"pusher": pusher} | body)


def gathered(models: Snapshot, requests: list[PredictRequest]) -> list[Answer | BaseException]:
    """The outcomes of requests of one turn."""

    async def together() -> list[Answer | BaseException]:
        """All in one turn."""
        batcher = MicroBatcher()
        asked = (batcher.answer(ask_single(models, one)) for one in requests)
        return await asyncio.wait_for(asyncio.gather(*asked, return_exceptions=True), 10.0)

    return asyncio.run(together())


def calls(models: Snapshot, name: str) -> list[int]:
    """How many pushes each call of a fake was about, its self-check left out."""
    predictor = models.models[name, 1].predictor
    assert isinstance(predictor, FakePredictor)
    return [len(pushers) for pushers in predictor.calls[1:]]


def test_pushes_of_a_turn_are_one_call_with_an_answer_each(models: Snapshot) -> None:
    """Of two objects and of one, in the world and on the object: what each gets alone."""
    descriptors = ("1a2b3c4a", "4a4a4a4a")
    requests = [request(n, context={"descriptor": descriptors[n % 2]}) for n in range(9)]
    requests.append(request(1, context={"descriptor": "1a2b3c4a"}, object_pose={"x": 0.01, "y": 0.0, "angle": 1.0}))

    answers = gathered(models, requests)

    assert calls(models, "push-indicator") == [10]
    assert answers == [ask_single(models, one).answer() for one in requests]
    assert len({answer.content for answer in answers if isinstance(answer, Answer)}) == 10


def test_models_and_kinds_of_object_have_a_call_each(models: Snapshot) -> None:
    """Pushes for different models stand beside each other in nothing."""
    visual = {"visual": [[0.5] * 32] * 32}
    requests = [request(0), request(1, context={"descriptor": "1a2b3c4a"}), request(2, context=visual), request(3)]

    answers = gathered(models, requests)

    assert [answer.model for answer in answers if isinstance(answer, Answer)] == [
        "push-none",
        "push-indicator",
        "push-visual",
        "push-none",
    ]
    assert [calls(models, f"push-{kind}") for kind in ("none", "indicator", "visual")] == [[2], [1], [1]]


def test_a_crowd_is_more_than_one_call(models: Snapshot) -> None:
    """So that no call holds the loop for long."""
    answers = gathered(models, [request(number) for number in range(2 * MAX_PUSHES_PER_CALL + 1)])

    assert calls(models, "push-none") == [MAX_PUSHES_PER_CALL, MAX_PUSHES_PER_CALL, 1]
    assert all(isinstance(answer, Answer) for answer in answers)


def test_a_push_that_fails_does_not_spoil_its_neighbours(models: Snapshot) -> None:
    """It is told so, and the others are answered."""
    x, y, angle = CHECKED_PUSH
    fine = {"pusher": {"x": x, "y": y, "angle": angle}, "model": "push-failing"}
    requests = [request(5, model="push-failing"), PredictRequest.model_validate(fine), request(6)]

    failed, *answered = gathered(models, requests)

    assert isinstance(failed, PredictionError)
    assert all(isinstance(answer, Answer) for answer in answered)


def test_a_context_of_the_wrong_kind_is_told_to_each(models: Snapshot) -> None:
    """As if it had been alone."""
    wrong = request(0, context={"descriptor": "1a2b3c4a"}, model="push-none")

    outcomes = gathered(models, [wrong, wrong, request(1, model="push-none")])

    assert [type(outcome) for outcome in outcomes] == [ContextKindError, ContextKindError, Answer]


def test_whatever_breaks_nobody_is_left_waiting(models: Snapshot) -> None:
    """Not even by an error that nobody expects."""
    broken = models.models["push-none", 1]
    assert isinstance(broken.predictor, FakePredictor)
    broken.predictor.calls = None  # type: ignore[assignment]  # so that every call raises AttributeError

    outcomes = gathered(models, [request(0), request(1)])

    assert [type(outcome) for outcome in outcomes] == [AttributeError, AttributeError]


def test_who_left_is_not_answered_and_disturbs_nobody(models: Snapshot) -> None:
    """A client that goes away before its turn is over."""

    async def scenario() -> Answer:
        """One leaves, one stays."""
        batcher = MicroBatcher()
        leaving = asyncio.create_task(batcher.answer(ask_single(models, request(0))))
        staying = asyncio.create_task(batcher.answer(ask_single(models, request(1))))
        await asyncio.sleep(0)
        leaving.cancel()
        return await staying

    assert asyncio.run(scenario()) == ask_single(models, request(1)).answer()


def test_every_request_tells_what_the_call_took(models: Snapshot) -> None:
    """Once each, in its own parts."""

    async def one(batcher: MicroBatcher, number: int) -> Timings:
        """A request that listens."""
        timings: Timings = []
        collect_timings(timings)
        await batcher.answer(ask_single(models, request(number)))
        return timings

    async def scenario() -> list[Timings]:
        """Three of them."""
        batcher = MicroBatcher()
        return await asyncio.gather(*(asyncio.create_task(one(batcher, number)) for number in range(3)))

    found = asyncio.run(scenario())

    assert [[phase for phase, _ in timings] for timings in found] == [["inference"]] * 3


def test_a_turn_after_another_is_asked_too(models: Snapshot) -> None:
    """Nothing of the first is left in the second."""

    async def scenario() -> list[Answer]:
        """One after the other."""
        batcher = MicroBatcher()
        return [await batcher.answer(ask_single(models, request(number))) for number in range(2)]

    assert asyncio.run(scenario()) == [ask_single(models, request(number)).answer() for number in range(2)]
    assert calls(models, "push-none") == [1, 1, 1, 1]
