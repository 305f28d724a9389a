"""Probes run together, and a slow model delays the result of no other one."""

import asyncio
import threading
from dataclasses import replace

import pytest

from service.inference import probing
from service.inference.probing import Key, Probing
from service.model.loaded_model import LoadedModel
from service.model.tensors import FloatArray, Gaussians, IndexArray
from tests.fakes import FakePredictor, Panic, draft_manifest


class Held(FakePredictor):
    """A predictor that answers once a test releases it, or panics."""

    def __init__(self, released: threading.Event, error: BaseException | None = None) -> None:
        super().__init__(b"", takes_context=True)
        self.released = released
        self.error = error

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``FakePredictor``."""
        self.released.wait()
        if self.error is not None:
            raise self.error
        return super().predict(pusher, contexts, context_index)


def loaded(version: int, predictor: FakePredictor) -> tuple[Key, LoadedModel]:
    """Return a loaded version."""
    manifest = replace(draft_manifest(), version=version)
    return (manifest.name, version), LoadedModel(manifest, "", predictor)


def opened() -> threading.Event:
    """Return an event that is set."""
    event = threading.Event()
    event.set()
    return event


def test_seven_models_that_hang_delay_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models that hang get their own reason. The last one is settled while they hang, and later rounds skip them."""
    monkeypatch.setattr(probing, "PLACE_S", 0.02)
    released = threading.Event()
    models = dict(loaded(number, Held(released)) for number in range(1, 8)) | dict([loaded(8, Held(opened()))])
    settled: dict[Key, str | None] = {}

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        found = Probing(0.5)
        async with asyncio.timeout(30):
            first = asyncio.ensure_future(found.probe(models, settled.__setitem__))
            while not settled:
                await asyncio.sleep(0.001)
            assert settled == {("push-indicator", 8): None}
            await first
            late = "the self-check did not end within 0.5 s"
            assert settled == {key: None if key[1] == 8 else late for key in models}
            threads = [thread.name for thread in threading.enumerate()].count("probe")
            settled.clear()
            await found.probe(models, settled.__setitem__)
            assert len(settled) == 8
            assert [thread.name for thread in threading.enumerate()].count("probe") == threads == 7
            released.set()
            while None in settled.values() and set(settled.values()) != {None}:
                await found.probe(models, settled.__setitem__)

    asyncio.run(scenario())


def test_few_probes_begin_at_once() -> None:
    """Each probe takes a processor, so not all models of a registry are probed at one moment."""
    released = threading.Event()
    models = dict(loaded(number, Held(released)) for number in range(1, 20))

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        running = asyncio.ensure_future(Probing(30.0).probe(models, lambda *_: None))
        await asyncio.sleep(0.05)
        assert [thread.name for thread in threading.enumerate()].count("probe") == probing.AT_ONCE
        released.set()
        await running

    asyncio.run(scenario())


def test_threads_of_models_that_hang_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """If too many threads hang, further models are not ready, and the reason says so."""
    monkeypatch.setattr(probing, "MAX_THREADS", 1)
    released = threading.Event()
    models = dict(loaded(number, Held(released)) for number in range(1, 3))
    settled: dict[Key, str | None] = {}

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        await Probing(0.01).probe(models, settled.__setitem__)
        released.set()

    asyncio.run(scenario())
    assert sorted(map(str, settled.values())) == [
        "the self-check could not begin: probe: all 1 threads are busy",
        "the self-check did not end within 0.01 s",
    ]


@pytest.mark.parametrize("error", [ZeroDivisionError("a bug"), Panic("a panic")], ids=repr)
def test_any_error_of_a_probe_is_a_reason_of_its_model(error: BaseException, caplog: pytest.LogCaptureFixture) -> None:
    """An unexpected error is logged with its model, and other models are probed."""
    models = dict([loaded(1, Held(opened(), error)), loaded(2, Held(opened()))])
    settled: dict[Key, str | None] = {}
    asyncio.run(Probing(30.0).probe(models, settled.__setitem__))
    assert settled == {
        ("push-indicator", 1): "the self-check failed; the log has the cause",
        ("push-indicator", 2): None,
    }
    (record,) = caplog.records
    assert record.exc_info
    assert record.exc_info[1] is error


def test_an_error_after_the_time_is_over_is_not_logged_by_asyncio(caplog: pytest.LogCaptureFixture) -> None:
    """A self-check that fails after its time leaves no error that was never retrieved."""
    released = threading.Event()
    models = dict([loaded(1, Held(released, ZeroDivisionError()))])

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        await Probing(0.01).probe(models, lambda *_: None)
        released.set()
        while "probe" in [thread.name for thread in threading.enumerate()]:
            await asyncio.sleep(0.001)
        await asyncio.sleep(0)

    asyncio.run(scenario())
    assert caplog.text == ""
