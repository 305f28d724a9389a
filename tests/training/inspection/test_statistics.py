"""Statistics of pushes beside the published ones."""

import numpy as np
import pytest

from tests.training.synthetic_omnipush import plausible_pushes
from training.inspection.statistics import QUANTILES, QUANTITIES, compare_statistics, missed, motion_quantiles
from training.omnipush.published import Normalisation, published_normalisation


def test_figures_are_means_and_deviations_in_order() -> None:
    """Means and deviations are those of pusher, then object, beside the published numbers of the same quantity."""
    published = published_normalisation()
    pushers, outcomes = plausible_pushes(100, 1)
    figures = compare_statistics(pushers, outcomes, published)

    assert [figure.quantity for figure in figures] == list(QUANTITIES)
    values = np.column_stack([pushers, outcomes])
    assert [figure.mean for figure in figures] == pytest.approx(values.mean(axis=0))
    assert [figure.std for figure in figures] == pytest.approx(values.std(axis=0))
    assert [figure.published_mean for figure in figures] == [*published.input_mean, *published.output_mean]
    assert [figure.published_std for figure in figures] == [*published.input_std, *published.output_std]


def test_the_ratio_is_one_where_the_spread_is_the_published_one() -> None:
    """A deviation equal to the published one has the ratio 1, and half of it the ratio 0.5."""
    pushers = np.array([[0.0, -2.0, 1.0], [4.0, 2.0, 3.0]])
    published = Normalisation(np.zeros(3), np.array([2.0, 2.0, 2.0]), np.zeros(3), np.ones(3))

    assert [figure.ratio for figure in compare_statistics(pushers, pushers, published)[:3]] == [1.0, 1.0, 0.5]


@pytest.mark.parametrize(
    ("outcome", "is_missed"),
    [
        ([0.0, 0.0, 0.0], True),
        ([0.0006, 0.0006, 0.014], True),
        ([0.0011, 0.0, 0.0], False),
        ([0.0, -0.0011, 0.0], False),
        ([0.0, 0.0, -0.016], False),
    ],
)
def test_a_push_that_neither_moved_nor_turned_the_object_missed(outcome: list[float], is_missed: bool) -> None:
    """A push missed if the object moved by less than a millimetre and turned by less than 15 mrad, as by noise."""
    assert missed(np.array([outcome])).tolist() == [is_missed]


def test_quantiles_of_motion_are_of_the_pushes_that_moved() -> None:
    """Quantiles leave out the pushes that moved nothing, whose share is given, and the sign of a turn."""
    outcomes = np.array([[0.003, 0.004, -0.1], [0.0, 0.015, 0.3], [0.025, 0.0, 0.2], [0.0, 0.0, 0.001]])
    found = motion_quantiles(outcomes)

    assert found.still_share == 0.25
    assert found.distance_mm[2] == pytest.approx(15.0)
    assert found.turn_deg[2] == pytest.approx(np.degrees(0.2))
    assert found.distance_mm == pytest.approx(np.quantile([5.0, 15.0, 25.0], QUANTILES))
