"""Domain of the models of Omnipush's objects: familiar pushes, indicators and views, and unfamiliar ones."""

import math

import numpy as np
import pytest
import torch

from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext, SupportContext
from service.validity.domains import object_features
from training.networks.omnipush_domain import (
    OmnipushDomain,
    SupportDomain,
    exposure,
    push_features,
    weights,
    without_exposure,
)

PUSHERS = torch.tensor([[0.05, 0.0, math.pi], [0.0, 0.12, 0.0], [-0.08, 0.0, 0.3]])


def indicators(*descriptors: str) -> torch.Tensor:
    """Return the indicators of some objects."""
    return torch.from_numpy(np.stack([ObjectContext.from_descriptor(name).indicator() for name in descriptors]))


def crosses(count: int, seed: int = 0, noise: float = 0.02) -> torch.Tensor:
    """Draw views (count, 1, 32, 32) of crosses with arms of different lengths, on a table with noise."""
    rng = np.random.default_rng(seed)
    views = 0.1 + noise * rng.normal(size=(count, 1, 32, 32))
    for view in views[:, 0]:
        up, down, left, right = rng.integers(9, 13, size=4)
        view[16 - up : 16 + down, 11:21] = view[11:21, 16 - left : 16 + right] = 0.5
    return torch.from_numpy(views.astype(np.float32))


def test_features_of_a_push_are_its_start_and_its_aim() -> None:
    """The start is the distance from the centre, the aim that of the line, whichever way the push heads."""
    assert push_features(PUSHERS).numpy() == pytest.approx(
        np.array([[0.05, 0.0], [0.12, 0.12], [0.08, 0.08 * math.sin(0.3)]]), abs=1e-6
    )


def test_weights_are_counted_in_every_position() -> None:
    """The letters b, c, B and C are a weight each, and a is none."""
    assert weights(indicators("1a1a3a4a", "1b2C3a4a", "1c2B3b4c"))[:, 0].tolist() == [0.0, 2.0, 4.0]


@pytest.mark.parametrize("kind", [ContextKind.NONE, ContextKind.INDICATOR])
def test_starts_beyond_the_training_data_are_unfamiliar(kind: ContextKind) -> None:
    """A start nearer or further than any in training is outside, and one between them inside."""
    context = indicators("1a1a3a4a", "1b2C3a4a")
    domain = OmnipushDomain(kind).fit(PUSHERS, context)
    asked = torch.tensor([[0.07, 0.0, 1.0], [0.2, 0.0, math.pi], [0.01, 0.0, 0.0]])
    given = () if kind is ContextKind.NONE else (context, torch.zeros(3, dtype=torch.int64))

    assert (domain(asked, *given)[:, 0] > 1.0).tolist() == [False, True, True]


def test_a_push_straight_at_the_centre_is_familiar() -> None:
    """An aim of zero is in the middle of the domain, although the training pushes only come close to the centre."""
    close = torch.tensor([[0.05, 0.001, math.pi], [0.0, 0.12, 0.0]])
    domain = OmnipushDomain(ContextKind.NONE).fit(close, torch.zeros(2, 0))

    assert domain(torch.tensor([[-0.085, 0.0, 0.0]]))[:, 0].item() < 0.01
    low, high = domain.ranges()["aim_offset_m"]
    assert low == -high


def test_more_weights_than_in_training_are_unfamiliar() -> None:
    """An object with two weights is inside if the training objects have up to two. Three are outside."""
    domain = OmnipushDomain(ContextKind.INDICATOR).fit(PUSHERS, indicators("1a1a3a4a", "1b2C3a4a"))

    found = domain(PUSHERS[:2], indicators("1b2c3a4a", "1b2c3b4a"), torch.tensor([1, 0]))[:, 1]

    assert (found > 1.0).tolist() == [True, False], "each push has the distance of its own object"


def test_without_a_context_every_object_is_as_familiar() -> None:
    """A model without context says nothing of the object."""
    domain = OmnipushDomain(ContextKind.NONE).fit(PUSHERS, torch.zeros(3, 0))

    assert domain(PUSHERS)[:, 1].tolist() == [0.0, 0.0, 0.0]


def test_exposure_does_not_change_the_shape_of_a_view() -> None:
    """Views that differ in brightness and contrast have nearly the same features, and another exposure."""
    views = crosses(3)

    assert torch.allclose(without_exposure(views), without_exposure(0.8 * views + 0.05), atol=0.35)
    assert exposure(0.5 * views).numpy() == pytest.approx(0.5 * exposure(views).numpy(), rel=1e-4)


def test_views_of_other_things_are_unfamiliar() -> None:
    """Crosses of the kind that was fitted are inside. An empty table, a ball, and a bright cross are outside."""
    domain = OmnipushDomain(ContextKind.VISUAL).fit(PUSHERS, crosses(300).reshape(60, 5, 1, 32, 32))
    rows = torch.arange(32) - 15.5
    ball = 0.1 + 0.4 * ((rows[:, None] ** 2 + rows**2) < 49.0).float()
    others = torch.stack([torch.full((1, 32, 32), 0.1), ball[None], 2.0 * crosses(1, 5)[0]])
    index = torch.tensor([0, 1, 2])

    assert (domain(PUSHERS, others, index)[:, 1] > 1.0).tolist() == [True, True, True]
    familiar = crosses(100, seed=9)
    found = domain(PUSHERS[:1].expand(100, -1), familiar, torch.arange(100))[:, 1]
    assert (found > 1.0).float().mean() <= 0.05


def test_the_manifest_has_every_range_by_name() -> None:
    """The ranges name each feature with its unit, those of pushes and those of objects."""
    domain = OmnipushDomain(ContextKind.INDICATOR).fit(PUSHERS, indicators("1a1a3a4a", "1b2C3a4a"))

    assert domain.ranges()["start_distance_m"] == pytest.approx([0.05, 0.12])
    assert set(domain.ranges()) == {"start_distance_m", "aim_offset_m", "weights"}


def test_a_support_is_familiar_if_each_of_its_pushes_is() -> None:
    """One push of a support that starts too far away, or moves the object too far, makes it unfamiliar. Padding not."""
    generator = torch.Generator().manual_seed(0)
    bearing = torch.rand(200, generator=generator) * 2.0 * math.pi
    pushers = torch.stack([0.08 * torch.cos(bearing), 0.08 * torch.sin(bearing), bearing + math.pi], dim=-1)
    pushers[:, :2] *= torch.linspace(0.6, 1.4, 200)[:, None]
    outcomes = torch.randn(200, 3, generator=generator) * torch.tensor([0.01, 0.01, 0.1])
    domain = SupportDomain().fit(pushers, outcomes).eval()
    supports = pushers[:9].reshape(3, 3, 3).clone(), outcomes[:9].reshape(3, 3, 3).clone(), torch.ones(3, 3)
    supports[0][1, 2, :2] *= 5.0
    supports[1][2, 0, 0] = 0.3
    found = domain(pushers[:3], torch.tensor([2, 1, 0]), supports)

    assert (found[:, 0] <= 1.0).all()
    assert [bool(distance > 1.0) for distance in found[:, 1]] == [True, True, False]
    supports[2][1, 2], supports[2][2, 0] = 0.0, 0.0
    assert (domain(pushers[:3], torch.tensor([2, 1, 0]), supports)[:, 1] <= 1.0).all()


def test_the_ranges_of_supports_have_the_names_of_the_warnings() -> None:
    """Every feature of a support is in the manifest, and is one that a warning has words for."""
    domain = SupportDomain().fit(PUSHERS, torch.zeros(3, 3))
    support = SupportContext.of(np.array([[0.1, 0.0, 3.0]]), np.array([[0.01, 0.0, 0.1]]))
    features = object_features(ContextKind.SUPPORT, support.tensors())

    assert list(domain.ranges()) == ["start_distance_m", "aim_offset_m", *features]
