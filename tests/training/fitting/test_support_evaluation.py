"""Evaluation by the number of support pushes: the same targets, factors of their own, and those between."""

import numpy as np
import pytest
import torch

from tests.training.networks.fixed_process import fixed_process
from training.fitting.samples import Samples
from training.fitting.support_evaluation import COUNTS, DRAWS, SupportFigures, evaluate_supports


@pytest.fixture(scope="module")
def figures() -> SupportFigures:
    """Return the figures of a process with fixed weights, of objects whose pushes all have the same outcome."""
    inputs = torch.randn(4, 250, 3, generator=torch.Generator().manual_seed(1))
    outcomes = torch.arange(4.0)[:, None, None].expand(4, 250, 3)
    samples = Samples(inputs, outcomes, torch.ones(4, 250), torch.zeros(4, 0), (1.0, 1.0, 1.0))
    return evaluate_supports(fixed_process(), samples)


def test_every_number_of_pushes_is_measured_on_the_same_targets(figures: SupportFigures) -> None:
    """Outcomes and inputs are the same for every number, three draws of 200 of each object, and predictions differ."""
    assert tuple(figures.predictions) == COUNTS
    first, *others = figures.predictions.values()
    assert len(first.outcome) == DRAWS * 4 * 200
    for other in others:
        assert (other.outcome == first.outcome).all()
        assert (other.inputs == first.inputs).all()
        assert (other.mean != first.mean).any()


def test_central_intervals_hold_their_share_for_every_number(figures: SupportFigures) -> None:
    """After calibration by halves of the objects, the factors keep deviations positive and finite."""
    assert all(0.0 < factor < np.inf for factor in figures.factors.values())
    assert all(np.isfinite(each.measures().nll) for each in figures.predictions.values())


def test_the_factor_of_another_number_lies_between() -> None:
    """Every number of pushes has a factor: the measured one, or one between its neighbours by their ratio."""
    found = SupportFigures({50: 1.0, 10: 1.5, 5: 2.0, 1: 4.0}, {}).scales()

    assert found.shape == (51,)
    assert found[[1, 5, 10, 50]] == pytest.approx([4.0, 2.0, 1.5, 1.0])
    assert found[0] == found[1]
    assert (np.diff(found[1:]) < 0.0).all()
    assert 1.5 < found[7] < 2.0
