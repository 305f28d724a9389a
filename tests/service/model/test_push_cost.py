"""The cost of a version bounds the time of any number of pushes, and follows the measurements of its probes."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from service.model.push_cost import PushCost
from service.model.self_check import measure_cost
from service.model.tensors import ContextKind, FloatArray, Gaussians, IndexArray
from tests.fakes import FakePredictor, draft_manifest


@pytest.mark.parametrize(
    ("pushes", "contexts", "expected"), [(1, 1, 0.2), (4, 2, 0.2), (40, 1, 2.0), (4, 6, 0.6), (8, 8, 0.8)]
)
def test_the_time_is_bounded_by_pushes_and_contexts(pushes: int, contexts: int, expected: float) -> None:
    """A call that is several times larger takes at most as many times longer, and no call takes less than one."""
    assert PushCost(4, 2, 0.2).seconds_of(pushes, contexts) == pytest.approx(expected)


def test_a_time_is_enough_for_a_number_of_pushes_and_contexts() -> None:
    """The number that fits takes no more than the time, and there is always one."""
    cost = PushCost(4, 2, 0.2)
    assert cost.seconds_of(cost.pushes_within(1.0), 1) <= 1.0
    assert cost.seconds_of(cost.contexts_within(1.0), cost.contexts_within(1.0)) <= 1.0
    assert (cost.pushes_within(1e-9), cost.contexts_within(1e-9)) == (1, 1)
    assert min(PushCost().pushes_within(1.0), PushCost().contexts_within(1.0)) > 10_000


def test_a_measurement_replaces_the_last_one_unless_it_is_far_above() -> None:
    """A faster call counts at once, a much slower one in steps: the machine may have been busy."""
    cost = PushCost(call_s=0.1)
    found = []
    for measured in (0.02, 0.03, 9.0, 9.0):
        cost.renew(measured)
        found.append(cost.call_s)
    assert found == pytest.approx([0.02, 0.03, 0.06, 0.12])


@dataclass
class SlowPredictor(FakePredictor):
    """A predictor whose calls take given times, in s."""

    seconds: Sequence[float] = (0.0,)

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``FakePredictor``."""
        time.sleep(self.seconds[min(len(self.calls), len(self.seconds) - 1)])
        return super().predict(pusher, contexts, context_index)


def test_the_self_check_measures_the_lowest_of_several_calls() -> None:
    """A first call that is slower than the others does not count."""
    predictor = SlowPredictor(b"", takes_context=True, seconds=(0.06, 0.0))
    cost = measure_cost(draft_manifest(), predictor)
    assert 0.0 < cost.call_s < 0.06
    assert (cost.pushes, cost.contexts, len(predictor.calls)) == (4, 1, 3)


def test_a_long_self_check_runs_once() -> None:
    """A slow graph does not make loading three times as long."""
    predictor = SlowPredictor(b"", takes_context=False, seconds=(0.11,))
    cost = measure_cost(draft_manifest("push-none", ContextKind.NONE), predictor)
    assert cost.call_s >= 0.11
    assert len(predictor.calls) == 1


def test_a_model_without_contexts_has_a_cost() -> None:
    """The number of contexts is at least one, so that nothing is divided by zero."""
    cost = measure_cost(draft_manifest("push-none", ContextKind.NONE), FakePredictor(b"", takes_context=False))
    assert cost.contexts == 1
    assert np.isfinite(cost.seconds_of(10_000, 0))
