"""Familiarity: distances from training data, at most 1 inside, and more than 1 outside."""

import pytest
import torch

from training.networks.familiarity import FeatureRanges, FeatureSpace


def normals(*shape: int, seed: int = 0) -> torch.Tensor:
    """Draw standard normal numbers."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_the_edge_of_a_range_is_at_distance_one() -> None:
    """The distance is 0 in the middle of a range, 1 at its ends, and grows in proportion beyond them."""
    known = FeatureRanges(["start_distance_m"]).fit(torch.tensor([[0.05], [0.07], [0.15]]))

    found = known(torch.tensor([[0.10], [0.05], [0.15], [0.20], [0.0]]))

    assert found.tolist() == pytest.approx([0.0, 1.0, 1.0, 2.0, 2.0], abs=1e-5)


def test_the_feature_that_is_furthest_out_counts() -> None:
    """One feature outside of its range makes a query unfamiliar, however ordinary the others are."""
    known = FeatureRanges(["size_m", "length_m"]).fit(torch.tensor([[0.0, 0.0], [1.0, 10.0]]))

    assert known(torch.tensor([[0.5, 20.0], [2.0, 5.0], [0.9, 9.0]])).tolist() == pytest.approx([3.0, 3.0, 0.8])


def test_ranges_have_names_for_the_manifest() -> None:
    """The ranges by name hold the ends of the training data, without the share left out, and with the margin."""
    features = torch.arange(-50.0, 51.0)[:, None]

    assert FeatureRanges(["a"]).fit(features).ranges() == {"a": [-50.0, 50.0]}
    assert FeatureRanges(["a"]).fit(features, left_out=0.1).ranges() == {"a": [-40.0, 40.0]}
    assert FeatureRanges(["a"]).fit(features, margin=0.5).ranges() == {"a": [-100.0, 100.0]}


def test_a_feature_that_never_changed_allows_that_value_only() -> None:
    """A constant feature keeps distances finite: its value is inside, any other is far outside."""
    known = FeatureRanges(["length_m"]).fit(torch.full((5, 1), 0.05))

    inside, outside = known(torch.tensor([[0.05], [0.06]])).tolist()

    assert inside <= 1.0
    assert 1.0 < outside < float("inf")


def test_nothing_is_familiar_before_a_fit() -> None:
    """Fresh modules call ordinary features unfamiliar."""
    features = normals(20, 4) + 3.0

    assert (FeatureRanges(list("abcd"))(features) > 1.0).all()
    assert (FeatureSpace(4, 2)(features) > 1.0).all()


def test_a_space_knows_how_features_occur_together() -> None:
    """Two features that are always equal are unfamiliar when they differ, though each by itself is ordinary."""
    both = normals(2000, 1).expand(-1, 2) + 0.01 * normals(2000, 2, seed=1)
    space = FeatureSpace(2, 1).fit(both[:1000], both[1000:], false_alarms=0.01)

    assert (space(both) > 1.0).float().mean() < 0.03
    assert space(torch.tensor([[1.0, -1.0]])).item() > 1.0, "off the axis"
    assert space(torch.tensor([[9.0, 9.0]])).item() > 1.0, "far out along the axis"


def test_false_alarms_are_as_rare_as_asked_on_features_that_were_not_fitted() -> None:
    """Each of the two thresholds is exceeded by its share of the familiar features."""
    features = normals(6000, 8) * torch.linspace(0.1, 2.0, 8)
    space = FeatureSpace(8, 3).fit(features[:2000], features[2000:4000], false_alarms=0.005)

    assert 0.0 < (space(features[4000:]) > 1.0).float().mean() < 0.02


def test_distances_of_absurd_features_stay_finite() -> None:
    """Huge features have a large, finite distance, which a float32 graph can return."""
    ranges = FeatureRanges(["a"]).fit(torch.tensor([[0.0], [1.0]]))
    space = FeatureSpace(3, 1).fit(normals(50, 3), normals(50, 3, seed=1))

    assert 1.0 < ranges(torch.tensor([[1e30]])).item() < float("inf")
    assert 1.0 < space(torch.full((1, 3), 1e12)).item() < float("inf")


def test_a_margin_leaves_lengths_above_zero() -> None:
    """A range of lengths is not widened below zero, and one of signed values is widened at both ends."""
    features = torch.tensor([[0.01, -1.0], [1.01, 1.0]])
    ranges = FeatureRanges(("length_m", "offset_m")).fit(features, margin=0.1).ranges()
    assert ranges["length_m"] == pytest.approx([0.0, 1.11])
    assert ranges["offset_m"] == pytest.approx([-1.2, 1.2])
