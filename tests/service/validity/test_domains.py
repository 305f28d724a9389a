"""Domains: features of pushes, and those out of range in words."""

import math
from dataclasses import replace

import numpy as np

from service.model.manifest import Validity
from service.validity.domains import RING, in_words, outside, push_features, validity_of
from tests.fakes import draft_manifest


def test_features_are_taken_about_the_centre_of_the_object() -> None:
    """The distance of the start from the centre, that of the line from it, and the length, all in m."""
    pushers = np.array([[-0.08, 0.0, 0.0, 0.05], [0.0, -0.08, math.pi / 2, 0.02], [-0.08, 0.01, 0.0, 0.05]])
    found = push_features(pushers, np.array([0.0, 0.0]))
    np.testing.assert_allclose(found["start_distance_m"], [0.08, 0.08, math.hypot(0.08, 0.01)])
    np.testing.assert_allclose(found["aim_offset_m"], [0.0, 0.0, 0.01], atol=1e-12)
    assert found["length_m"].tolist() == [0.05, 0.02, 0.05]
    moved = push_features(pushers + np.array([1.0, 2.0, 0.0, 0.0]), np.array([1.0, 2.0]))
    np.testing.assert_allclose(moved["aim_offset_m"], found["aim_offset_m"], atol=1e-12)


def test_only_features_with_a_range_can_be_outside() -> None:
    """A domain without a range of a feature vouches for every value of it."""
    validity = Validity({"length_m": (0.01, 0.1)}, "a test")
    features = {"start_distance_m": np.array([9.0, 9.0]), "length_m": np.array([0.05, 0.2])}
    assert outside(validity, features).tolist() == [False, True]
    assert in_words(validity, {"start_distance_m": 9.0, "length_m": 0.2}) == [
        "the push is 0.2 m long (known: 0.01 to 0.1 m)"
    ]
    assert in_words(None, {"length_m": 0.2}) == []


def test_versions_from_before_domains_vouch_for_the_ring() -> None:
    """Formats 1 and 2 have no domain in the manifest. A later version without one vouches for none."""
    assert validity_of(replace(draft_manifest(), format=2)) is RING
    assert validity_of(replace(draft_manifest(), format=3)) is None
