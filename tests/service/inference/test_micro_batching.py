"""Single pushes of one iteration of the event loop run in one call of the runtime, with an answer each."""

import asyncio
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from service.api.v1.queries import ask_single
from service.errors import ContextKindError, PredictionError
from service.inference.micro_batching import CALL_S, ITERATION_S, MAX_PUSHES_PER_CALL, MicroBatcher
from service.inference.query import Answer
from service.inference.snapshot import Snapshot
from service.model.push_cost import PushCost
from service.model.tensors import ContextKind
from service.observability.timings import Timings, collect_timings
from service.schemas.pushes import PredictRequest
from tests.fakes import BUGGY, CHECKED_PUSH, FAILING, FakePredictor, fake_models, publish_fake


@pytest.fixture
def models(tmp_path: Path) -> Snapshot:
    """Return fake models of every kind, and one that fails except in its self-check."""
    registry, found = fake_models(tmp_path / "models")
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    publish_fake(registry, "push-failing", ContextKind.NONE, model=FAILING)
    publish_fake(registry, "push-buggy", ContextKind.NONE, model=BUGGY)
    found.refresh()
    for model in found.snapshot.models.values():
        assert isinstance(model.predictor, FakePredictor)
        model.predictor.calls.clear()  # those of its self-check
    return found.snapshot


def request(number: int = 0, **body: Any) -> PredictRequest:
    """Return a request for a push that differs by its number."""
    pusher = {"x": -0.08 + 0.001 * (number % 100), "y": 0.001 * (number // 100), "angle": 0.0}
    return PredictRequest.model_validate({"pusher": pusher} | body)


def answered(models: Snapshot, requests: list[PredictRequest]) -> list[Answer | BaseException]:
    """Answer requests of one iteration, and return their outcomes."""

    async def together() -> list[Answer | BaseException]:
        """Answer all of them together."""
        batcher = MicroBatcher()
        answers = (batcher.answer(ask_single(models, one)) for one in requests)
        return await asyncio.wait_for(asyncio.gather(*answers, return_exceptions=True), 10.0)

    return asyncio.run(together())


def calls(models: Snapshot, name: str) -> list[int]:
    """Return the number of pushes in each call of a fake predictor."""
    predictor = models.models[name, 1].predictor
    assert isinstance(predictor, FakePredictor)
    return [len(pushers) for pushers in predictor.calls]


def test_pushes_of_an_iteration_are_one_call(models: Snapshot) -> None:
    """Pushes of several objects and frames share a call, and each gets the answer that it gets alone."""
    descriptors = ("1a2b3c4a", "4a4a4a4a")
    requests = [request(n, context={"descriptor": descriptors[n % 2]}) for n in range(9)]
    requests.append(request(1, context={"descriptor": "1a2b3c4a"}, object_pose={"x": 0.01, "y": 0.0, "angle": 1.0}))

    answers = answered(models, requests)

    assert calls(models, "push-indicator") == [10]
    assert answers == [ask_single(models, one).answer() for one in requests]
    assert len({answer.content for answer in answers if isinstance(answer, Answer)}) == 10


def test_each_model_has_its_own_call(models: Snapshot) -> None:
    """Pushes for different models are never in the same call."""
    visual = {"visual": [[0.5] * 32] * 32}
    requests = [request(0), request(1, context={"descriptor": "1a2b3c4a"}), request(2, context=visual), request(3)]

    answers = answered(models, requests)

    assert [answer.model for answer in answers if isinstance(answer, Answer)] == [
        "push-none",
        "push-indicator",
        "push-visual",
        "push-none",
    ]
    assert [calls(models, f"push-{kind}") for kind in ("none", "indicator", "visual")] == [[2], [1], [1]]


def test_a_call_has_a_maximum_of_pushes(models: Snapshot) -> None:
    """Many pushes are split into several calls, so that no call holds the event loop for long."""
    answers = answered(models, [request(number) for number in range(2 * MAX_PUSHES_PER_CALL + 1)])

    assert calls(models, "push-none") == [MAX_PUSHES_PER_CALL, MAX_PUSHES_PER_CALL, 1]
    assert all(isinstance(answer, Answer) for answer in answers)


def test_a_call_is_bounded_in_time(models: Snapshot) -> None:
    """A version with slow pushes gets calls of fewer pushes, and at least one."""
    for call_s, expected in ((CALL_S / 10, 10), (CALL_S / 1.5, 1)):
        predictor = FakePredictor(b"", takes_context=False)
        slow = replace(models.find_default(ContextKind.NONE), predictor=predictor, cost=PushCost(call_s=call_s))
        answers = answered(Snapshot({("push-none", 1): slow}, models.aliases), [request(n) for n in range(23)])
        assert max(map(len, predictor.calls)) == expected
        assert all(isinstance(answer, Answer) for answer in answers)


def test_an_iteration_is_bounded_in_time(models: Snapshot) -> None:
    """When the calls of an iteration have taken their time, other events come before the remaining calls."""
    order: list[str] = []

    class Slow(FakePredictor):
        """A predictor of which one call takes longer than an iteration may."""

        def predict(self, *asked: Any) -> Any:
            """See ``FakePredictor``."""
            order.append("call")
            time.sleep(1.1 * ITERATION_S)
            return super().predict(*asked)

    slow = replace(
        models.find_default(ContextKind.NONE), predictor=Slow(b"", takes_context=False), cost=PushCost(call_s=CALL_S)
    )
    served = Snapshot({("push-none", 1): slow}, models.aliases)

    async def scenario() -> list[object]:
        """Submit three pushes, of which each is a call, and then another event."""
        outcomes: list[object] = []
        batcher = MicroBatcher()
        for number in range(3):
            batcher.submit(ask_single(served, request(number)), outcomes.append)
        asyncio.get_running_loop().call_soon(order.append, "event")
        while len(outcomes) < 3:
            await asyncio.sleep(0)
        return outcomes

    assert not any(isinstance(outcome, Exception) for outcome in asyncio.run(scenario()))
    assert order == ["call", "event", "call", "call"]


def test_a_failing_push_does_not_fail_others(models: Snapshot) -> None:
    """A push that fails gets its error, and the other pushes of its call are answered."""
    x, y, angle = CHECKED_PUSH
    fine = {"pusher": {"x": x, "y": y, "angle": angle}, "model": "push-failing"}
    requests = [request(5, model="push-failing"), PredictRequest.model_validate(fine), request(6)]

    failed, *others = answered(models, requests)

    assert isinstance(failed, PredictionError)
    assert all(isinstance(answer, Answer) for answer in others)


def test_each_push_with_a_wrong_kind_of_context_gets_its_error(models: Snapshot) -> None:
    """Pushes with a wrong kind of context fail alone, and others are answered."""
    wrong = request(0, context={"descriptor": "1a2b3c4a"}, model="push-none")

    outcomes = answered(models, [wrong, wrong, request(1, model="push-none")])

    assert [type(outcome) for outcome in outcomes] == [ContextKindError, ContextKindError, Answer]


def test_an_unexpected_exception_reaches_every_push(models: Snapshot) -> None:
    """A bug in the predictor raises its exception for each push, so that no client waits for ever."""
    outcomes = answered(models, [request(1, model="push-buggy"), request(2, model="push-buggy")])

    assert [type(outcome) for outcome in outcomes] == [ZeroDivisionError, ZeroDivisionError]


def test_a_cancelled_push_does_not_affect_others(models: Snapshot) -> None:
    """If a client disconnects before the end of the iteration, the other pushes are answered."""

    async def scenario() -> Answer:
        """Cancel one of two pushes."""
        batcher = MicroBatcher()
        leaving = asyncio.create_task(batcher.answer(ask_single(models, request(0))))
        staying = asyncio.create_task(batcher.answer(ask_single(models, request(1))))
        await asyncio.sleep(0)
        leaving.cancel()
        return await staying

    assert asyncio.run(scenario()) == ask_single(models, request(1)).answer()


def test_each_request_records_the_time_of_its_call(models: Snapshot) -> None:
    """Each request of a call records one inference time."""

    async def one(batcher: MicroBatcher, number: int) -> Timings:
        """Run a request that collects its timings."""
        timings: Timings = []
        collect_timings(timings)
        await batcher.answer(ask_single(models, request(number)))
        return timings

    async def scenario() -> list[Timings]:
        """Run three requests."""
        batcher = MicroBatcher()
        return await asyncio.gather(*(asyncio.create_task(one(batcher, number)) for number in range(3)))

    found = asyncio.run(scenario())

    assert [[phase for phase, _ in timings] for timings in found] == [["inference"]] * 3


def test_successive_iterations_are_answered(models: Snapshot) -> None:
    """An iteration leaves no push behind for the next one."""

    async def scenario() -> list[Answer]:
        """Answer one after the other."""
        batcher = MicroBatcher()
        return [await batcher.answer(ask_single(models, request(number))) for number in range(2)]

    assert asyncio.run(scenario()) == [ask_single(models, request(number)).answer() for number in range(2)]
    assert calls(models, "push-none") == [1, 1, 1, 1]


def test_an_error_reaches_its_callback_at_the_end_of_the_iteration() -> None:
    """A push that cannot be submitted fails together with the others, and not before."""
    outcomes: list[object] = []

    async def scenario() -> list[object]:
        """Fail two pushes, and flush none of them by hand."""
        batcher = MicroBatcher()
        for error in (ValueError(), KeyError()):
            batcher.fail(error, outcomes.append)
        before = list(outcomes)
        await asyncio.sleep(0)
        return before

    assert asyncio.run(scenario()) == []
    assert [type(outcome) for outcome in outcomes] == [ValueError, KeyError]


def test_a_callback_that_raises_does_not_affect_others(models: Snapshot, caplog: pytest.LogCaptureFixture) -> None:
    """A bug in one callback is logged, and the other callbacks are called."""
    outcomes: list[object] = []

    def fail(_: object) -> None:
        """Raise an exception."""
        raise ZeroDivisionError

    async def scenario() -> None:
        """Submit two pushes."""
        batcher = MicroBatcher()
        for callback in (fail, outcomes.append):
            batcher.submit(ask_single(models, request()), callback)
        batcher.flush()

    asyncio.run(scenario())
    assert len(outcomes) == 1
    assert "an answer was lost" in caplog.text
