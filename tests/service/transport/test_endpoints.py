"""The table of endpoints finds the endpoint of a path, and answers each request where its weight says."""

import asyncio
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar, TypeVarTuple

import numpy as np
import pytest

from service.errors import InvalidRequestError, NotAcceptableError
from service.inference.loaded_models import LoadedModels
from service.inference.micro_batching import CALL_S
from service.inference.query import Answer, ContextBatch, Query, Warnings
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.push_cost import PushCost
from service.model.reference import ModelReference
from service.model.tensors import ContextKind, FloatArray, Gaussians, IndexArray
from service.transport.endpoints import (
    BODY_GROWTH,
    LIGHT_PUSHES,
    NO_PARAMETERS,
    Endpoint,
    Endpoints,
    Headers,
    HttpRequest,
    Weight,
    header,
)
from service.transport.threads import ThreadPool
from tests.fakes import FakePredictor, fake_models

T = TypeVar("T")
Ts = TypeVarTuple("Ts")
Step = tuple[str, bool]  # its name, and True in the thread of the event loop
REQUEST = HttpRequest([], b"1", NO_PARAMETERS)


@dataclass
class Steps:
    """The steps of requests, in order, each with its thread."""

    taken: list[Step] = field(default_factory=list)

    def add(self, name: str) -> None:
        """Note a step in this thread."""
        self.taken.append((name, threading.current_thread() is threading.main_thread()))

    def names(self) -> list[str]:
        """Return the names of the steps."""
        return [name for name, _ in self.taken]


@dataclass
class NotingPredictor(FakePredictor):
    """A predictor that notes its calls."""

    steps: Steps = field(default_factory=Steps)

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``FakePredictor``."""
        self.steps.add("predict")
        return super().predict(pusher, contexts, context_index)


@dataclass(frozen=True, slots=True)
class NotingQuery(Query):
    """A query that notes the encoding of its answer, which is the number of pushes."""

    steps: Steps

    def encode(self, found: Gaussians, warnings: Warnings) -> Answer:
        """See ``Query.encode``."""
        self.steps.add("encode")
        return Answer(b"%d" % len(found.mean), "push-none", 1, len(found.mean))


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Return loaded fake models."""
    return fake_models(tmp_path_factory.mktemp("models"))[1]


@pytest.fixture
def steps() -> Steps:
    """Return the steps of a test."""
    return Steps()


@pytest.fixture
def model(models: LoadedModels, steps: Steps) -> LoadedModel:
    """Return a model without context whose predictor notes its calls."""
    found = models.snapshot.find(ModelReference.parse("push-none"))
    return replace(found, predictor=NotingPredictor(b"", False, steps=steps), cost=PushCost())


def fake_endpoint(
    steps: Steps, model: LoadedModel, weight: Weight, *, is_read_quickly: bool = True, path: str = "/fake"
) -> Endpoint[int]:
    """Create an endpoint whose requests are a number of pushes. Every step is noted."""

    def check(_headers: Headers) -> None:
        steps.add("check")

    def read(request: HttpRequest) -> int:
        steps.add("read")
        return int(request.content)

    def ask(_models: Snapshot, pushes: int) -> Query:
        steps.add("ask")
        contexts = ContextBatch(ContextKind.NONE, (), None, "body.context")
        return NotingQuery(model, np.zeros((pushes, 3), dtype=np.float32), contexts, (), steps)

    return Endpoint(path, check, read, ask, lambda _: weight, lambda _: is_read_quickly)


class NotingThreads(ThreadPool):
    """A thread pool that notes the caller and the memory of each job."""

    def __init__(self) -> None:
        super().__init__(1, 8, 10.0)
        self.noted: list[tuple[str, int]] = []

    async def run(self, function: Callable[[*Ts], T], *args: *Ts, caller: str = "", size_bytes: int = 0) -> T:
        """See ``ThreadPool.run``."""
        self.noted.append((caller, size_bytes))
        return await super().run(function, *args, caller=caller, size_bytes=size_bytes)


def table(models: LoadedModels, *endpoints: Endpoint[int]) -> Endpoints:
    """Return a table of these endpoints."""
    return Endpoints(endpoints, models, ThreadPool(1, 8, 10.0))


def answered(endpoints: Endpoints, endpoint: Endpoint[int], *pushes: int) -> list[Answer]:
    """Answer requests for these numbers of pushes in one iteration of an event loop."""

    async def run() -> list[Answer]:
        """Answer all of them together."""
        requests = (HttpRequest([], b"%d" % number, NO_PARAMETERS) for number in pushes)
        return await asyncio.gather(*(endpoints.answer(endpoint, request) for request in requests))

    return asyncio.run(run())


TEMPLATES = ("/v1/predict", "/v2/models/{name}/infer", "/v2/models/{name}/versions/{version}/infer", "/a.b/{name}")


@pytest.mark.parametrize(
    ("path", "template", "parameters"),
    [
        ("/v1/predict", "/v1/predict", {}),
        ("/v2/models/push-none/infer", TEMPLATES[1], {"name": "push-none"}),
        ("/v2/models/push-none@champion/infer", TEMPLATES[1], {"name": "push-none@champion"}),
        ("/v2/models/a/versions/7/infer", TEMPLATES[2], {"name": "a", "version": "7"}),
        ("/a.b/c", TEMPLATES[3], {"name": "c"}),
        ("/v1/predict/", None, {}),
        ("/v1/predict\n", None, {}),
        ("/v1", None, {}),
        ("/v2/models//infer", None, {}),
        ("/v2/models/a/b/infer", None, {}),
        ("/v2/models/a/infer/b", None, {}),
        ("/axb/c", None, {}),
    ],
)
def test_a_path_finds_its_endpoint_and_its_parameters(
    models: LoadedModels, model: LoadedModel, steps: Steps, path: str, template: str | None, parameters: dict[str, str]
) -> None:
    """A parameter is text without a slash, every other character of a template stands for itself."""
    endpoints = table(models, *(fake_endpoint(steps, model, Weight.LIGHT, path=each) for each in TEMPLATES))
    found: tuple[Endpoint[int], Mapping[str, str]] | None = endpoints.find(path)
    if template is None:
        assert found is None
    else:
        assert found is not None
        assert (found[0], dict(found[1])) == (endpoints.at(template), parameters)


def test_an_unknown_template_has_no_endpoint(models: LoadedModels) -> None:
    """A route without an endpoint is an error of the programmer."""
    with pytest.raises(KeyError):
        table(models).at("/v1/predict")


@pytest.mark.parametrize(
    ("weight", "is_read_quickly", "pushes", "in_thread"),
    [
        (Weight.LIGHT, True, LIGHT_PUSHES, set()),
        (Weight.LIGHT, True, LIGHT_PUSHES + 1, {"predict"}),
        (Weight.HEAVY, True, 1, {"ask", "predict", "encode"}),
        (Weight.LIGHT, False, 1, {"read", "ask", "predict", "encode"}),
        (Weight.SINGLE, True, 1, set()),
    ],
    ids=["few pushes", "many pushes", "heavy", "a large body", "a single push"],
)
def test_the_weight_decides_the_thread_of_each_step(
    models: LoadedModels,
    model: LoadedModel,
    steps: Steps,
    weight: Weight,
    is_read_quickly: bool,
    pushes: int,
    in_thread: set[str],
) -> None:
    """Light steps run in the event loop, heavy ones in a thread, and each step runs exactly once."""
    endpoint = fake_endpoint(steps, model, weight, is_read_quickly=is_read_quickly)
    (answer,) = answered(table(models, endpoint), endpoint, pushes)
    assert answer.content == b"%d" % pushes
    assert steps.names() == ["check", "read", "ask", "predict", "encode"]
    assert {name for name, in_loop in steps.taken if not in_loop} == in_thread


@pytest.mark.parametrize("weight", [Weight.SINGLE, Weight.LIGHT])
@pytest.mark.parametrize(
    ("call_s", "pushes", "in_thread"),
    [(0.9 * CALL_S, 1, set()), (1.1 * CALL_S, 1, {"predict"}), (CALL_S / 50, 100, {"predict"}), (9.0, 1, {"predict"})],
    ids=["quick", "slow", "quick but many", "very slow"],
)
def test_a_slow_version_works_in_a_thread(
    models: LoadedModels,
    model: LoadedModel,
    steps: Steps,
    weight: Weight,
    call_s: float,
    pushes: int,
    in_thread: set[str],
) -> None:
    """Whatever the graph, the event loop predicts only as long as it may by the measured cost of the version."""
    endpoint = fake_endpoint(steps, replace(model, cost=PushCost(call_s=call_s)), weight)
    endpoints = table(models, endpoint)
    answered(endpoints, endpoint, pushes)
    assert {name for name, in_loop in steps.taken if not in_loop} == in_thread
    assert (endpoints.query_single(endpoint, REQUEST) is None) is (call_s > CALL_S or weight is not Weight.SINGLE)


def test_each_caller_has_a_share_of_the_threads(models: LoadedModels, model: LoadedModel, steps: Steps) -> None:
    """The caller of a request, and the memory that its body becomes, are those of its job."""
    endpoint = fake_endpoint(steps, model, Weight.HEAVY)
    threads = NotingThreads()
    request = HttpRequest([], b"0001", NO_PARAMETERS, "key:robot")
    for each in (endpoint, replace(endpoint, is_read_quickly=lambda _: False)):
        asyncio.run(Endpoints([each], models, threads).answer(each, request))
    assert threads.noted == [("key:robot", 4 * BODY_GROWTH)] * 2


def test_single_pushes_of_an_iteration_are_predicted_in_one_call(
    models: LoadedModels, model: LoadedModel, steps: Steps
) -> None:
    """Single pushes share a micro-batch, and each gets its own answer."""
    endpoint = fake_endpoint(steps, model, Weight.SINGLE)
    answers = answered(table(models, endpoint), endpoint, 1, 1, 1)
    assert [answer.content for answer in answers] == [b"1"] * 3
    assert steps.names().count("predict") == 1


def test_an_endpoint_may_answer_without_a_model(models: LoadedModels, model: LoadedModel, steps: Steps) -> None:
    """An answer in place of a query is sent as it is, and the shortcut leaves such requests to others."""
    endpoint = replace(fake_endpoint(steps, model, Weight.SINGLE), ask=lambda *_: Answer(b"done"))
    endpoints = table(models, endpoint)
    assert answered(endpoints, endpoint, 1) == [Answer(b"done")]
    assert endpoint.answer(models.snapshot, REQUEST) == Answer(b"done")
    assert endpoints.query_single(endpoint, REQUEST) is None


def refuse(error: Exception) -> Callable[[object], None]:
    """Return a check that raises an error."""

    def check(_: object) -> None:
        raise error

    return check


def test_the_headers_are_checked_before_the_body(models: LoadedModels, model: LoadedModel, steps: Steps) -> None:
    """A request with bad headers is not read."""
    endpoint = replace(fake_endpoint(steps, model, Weight.SINGLE), check=refuse(NotAcceptableError()))
    with pytest.raises(NotAcceptableError):
        answered(table(models, endpoint), endpoint, 1)
    assert steps.taken == []


@pytest.mark.parametrize("is_read_quickly", [True, False], ids=["in the loop", "in a thread"])
def test_a_request_that_cannot_be_read_raises_its_error(
    models: LoadedModels, model: LoadedModel, steps: Steps, is_read_quickly: bool
) -> None:
    """An error of the reader reaches the caller as it was raised, from the loop and from a thread."""

    def read(_: HttpRequest) -> int:
        raise InvalidRequestError.at("body", "no value", "a number")

    endpoint = replace(
        fake_endpoint(steps, model, Weight.LIGHT, is_read_quickly=is_read_quickly),
        read=read,
    )
    with pytest.raises(InvalidRequestError, match="body: received no value"):
        answered(table(models, endpoint), endpoint, 1)


@pytest.mark.parametrize("weight", Weight)
def test_the_query_of_a_single_push_is_given_and_of_no_other_request(
    models: LoadedModels, model: LoadedModel, steps: Steps, weight: Weight
) -> None:
    """The shortcut gets the query of a request that its iteration can predict."""
    endpoint = fake_endpoint(steps, model, weight)
    query = table(models, endpoint).query_single(endpoint, REQUEST)
    assert (query is not None) is (weight is Weight.SINGLE)


def test_the_first_header_of_a_name_counts() -> None:
    """A header that is sent twice has its first value, and an absent header has none."""
    headers = [(b"accept", b"one"), (b"accept", b"two")]
    assert header(headers, b"accept") == b"one"
    assert header(headers, b"authorization") is None
