"""Domains: features of pushes, and those out of range in words."""

import math
from dataclasses import replace

import numpy as np
import pytest

from service.model.manifest import Validity
from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext, SupportContext
from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from service.validity.domains import RING, in_words, object_features, outside, push_features, validity_of
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


def test_features_of_a_push_in_sizes_need_the_sizes() -> None:
    """A model of any shape knows lengths and starts as multiples of the size of the object."""
    pushers = np.array([[-0.08, 0.0, 0.0, 0.05]])
    assert "length_over_size" not in push_features(pushers, np.zeros(2))
    found = push_features(pushers, np.zeros((1, 2)), np.array([0.02]))
    assert found["length_over_size"].tolist() == [2.5]
    assert found["start_over_size"].tolist() == [4.0]


def test_features_of_objects_are_those_of_the_manifests() -> None:
    """Weights of a descriptor, levels of a view, for a shape its size and body, and the furthest of a support."""
    heavy = ObjectContext.from_descriptor("1b2b3c4a").tensor()
    assert object_features(ContextKind.INDICATOR, [heavy]) == {"weights": 3.0}
    half = np.zeros((1, 32, 32), dtype=np.float32)
    half[:, :16] = 1.0
    assert object_features(ContextKind.VISUAL, [half]) == {"view_mean": 0.5, "view_contrast": 0.5}
    box = Outline.of([[0.16, 0.14], [0.04, 0.14], [0.04, 0.06], [0.16, 0.06]])
    found = object_features(ContextKind.SHAPE, ShapeContext(box, (0.1, 0.12), 0.3, 0.005).tensors())
    size_m = math.sqrt((0.12**2 + 0.08**2) / 12.0)
    expected = {"size_m": size_m, "friction": 0.3, "pusher_radius_over_size": 0.005 / size_m}
    assert found == pytest.approx({**expected, "centre_of_mass_over_size": 0.02 / size_m}, rel=1e-5)
    assert object_features(ContextKind.NONE, []) == {}
    support = SupportContext.of(
        np.array([[-0.08, 0.0, 0.0], [0.0, -0.1, 0.0]]), np.array([[0.03, 0.04, -0.5], [0, 0, 0.2]])
    )
    assert object_features(ContextKind.SUPPORT, support.tensors()) == pytest.approx(
        {
            "support_nearest_start_m": 0.08,
            "support_furthest_start_m": 0.1,
            "support_furthest_aim_m": 0.1,
            "support_furthest_move_m": 0.05,
            "support_largest_turn_rad": 0.5,
        }
    )


def test_words_have_units_and_no_range_begins_below_zero() -> None:
    """The room around a range of counts is not shown, and a number without unit has none."""
    validity = Validity({"weights": (-0.2, 2.2), "friction": (0.1, 0.6)}, "a test")
    assert in_words(validity, {"weights": 3.0, "friction": 0.9}) == [
        "3 sides of the object have a weight (known: 0 to 2.2 sides)",
        "the friction is 0.9 (known: 0.1 to 0.6)",
    ]
