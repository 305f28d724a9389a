"""The served shape network: laws of pushing hold for any weights, and its domain knows what it was fitted to."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import norm

from service.model.tensors import ContextKind
from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from tests.served_graphs import BOX, L_SHAPE, shape_tensors
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.networks.shape_network import (
    LEAST_STD_M,
    LEAST_STD_RAD,
    PLACE_STD_M,
    SMALL_M,
    ShapeDomain,
    ShapeNetwork,
    near_miss,
)

PUSHES = np.array(
    [[-0.2, 0.005, 0.02, 0.2], [0.15, 0.1, -2.5, 0.25], [0.02, -0.2, 1.6, 0.22], [-0.2, 0.3, 0.0, 0.2]]
)  # the last misses


@pytest.fixture(scope="module")
def network() -> PushNetwork:
    """Return a network with random weights of a visible effect."""
    torch.manual_seed(3)
    found = PushNetwork(METHODS["FCN + CM"], PUSH_SHAPES[ContextKind.SHAPE]).eval()
    with torch.no_grad():
        for weights in found.parameters():
            weights.add_(0.05 * torch.randn_like(weights))
    return found


def answer(served: ShapeNetwork, context: ShapeContext, pushes: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the outputs of a network for pushes of one object."""
    parts = [torch.from_numpy(part) for part in shape_tensors(context)]
    index = torch.zeros(len(pushes), dtype=torch.int64)
    with torch.inference_mode():
        return tuple(part.numpy() for part in served(torch.from_numpy(pushes.astype(np.float32)), *parts, index))


def test_a_push_that_misses_is_exactly_at_rest(network: PushNetwork) -> None:
    """The mean of a miss is zero, bit by bit, and its std is the least one."""
    mean, std = answer(ShapeNetwork(network), ShapeContext(BOX), PUSHES)
    assert (mean[-1] == 0.0).all()
    assert std[-1] == pytest.approx([LEAST_STD_M, LEAST_STD_M, LEAST_STD_RAD])
    assert (np.abs(mean[:-1]).max(axis=1) > 0.01).all()


def test_a_push_that_just_misses_may_touch(network: PushNetwork) -> None:
    """Half a millimetre short of the object the mean is at rest, and the std is that of a place known within 1 mm."""
    context = ShapeContext(BOX, pusher_radius_m=0.005)
    mean, std = answer(ShapeNetwork(network), context, np.array([[-0.1, 0.0, 0.0, 0.0345], [-0.1, 0.0, 0.0, 0.01]]))
    assert (mean == 0.0).all()
    assert std[0, :2] == pytest.approx(0.46e-3, rel=0.05)
    assert std[0, 2] == pytest.approx(std[0, 0] / BOX.size_m, rel=0.1)
    assert std[1] == pytest.approx([LEAST_STD_M, LEAST_STD_M, LEAST_STD_RAD])


@pytest.mark.parametrize("places", [0.0, 0.5, 1.0, 2.0])
def test_the_std_of_a_near_miss_is_that_of_how_deep_the_tip_may_be(places: float) -> None:
    """The formula is sqrt(E max(0, n - u)^2) of a normal n."""
    exact = math.sqrt((1.0 + places**2) * norm.cdf(-places) - places * norm.pdf(places))
    found = near_miss(torch.tensor(places * PLACE_STD_M)).item()
    assert found == pytest.approx(PLACE_STD_M * exact, rel=0.05)


def test_twice_the_size_and_the_push_is_twice_the_answer(network: PushNetwork) -> None:
    """Metres double, radians stay."""
    mean, std = answer(ShapeNetwork(network), ShapeContext(L_SHAPE, pusher_radius_m=0.004), PUSHES)
    large = ShapeContext(Outline.of(2.0 * L_SHAPE.corners), pusher_radius_m=0.008)
    twice_mean, twice_std = answer(ShapeNetwork(network), large, PUSHES * np.array([2.0, 2.0, 1.0, 2.0]))
    assert twice_mean == pytest.approx(mean * [2.0, 2.0, 1.0], abs=3e-4)
    assert twice_std[:-1] == pytest.approx(std[:-1] * [2.0, 2.0, 1.0], rel=0.03)


def test_another_origin_is_another_frame_of_the_same_motion(network: PushNetwork) -> None:
    """The centroid ends in the same place wherever the frame's origin is, and yaw is the same."""
    away = np.array([0.05, -0.02])
    there = Outline.of(L_SHAPE.corners + away)
    mean, _ = answer(ShapeNetwork(network), ShapeContext(L_SHAPE), PUSHES)
    moved, std = answer(ShapeNetwork(network), ShapeContext(there), PUSHES + np.array([*away, 0.0, 0.0]))
    assert moved[:, 2] == pytest.approx(mean[:, 2], abs=5e-4)
    turn = mean[:, 2]
    turned = np.stack(
        [np.cos(turn) * away[0] - np.sin(turn) * away[1], np.sin(turn) * away[0] + np.cos(turn) * away[1]]
    )
    assert moved[:, :2] == pytest.approx(mean[:, :2] + away - turned.T, abs=3e-4)
    assert np.isfinite(std).all()


def test_the_scale_is_on_deviations_alone(network: PushNetwork) -> None:
    """Twice the factor is twice the std of a push that touches, and the same mean."""
    mean, std = answer(ShapeNetwork(network, scale=1.0), ShapeContext(BOX), PUSHES)
    same, twice = answer(ShapeNetwork(network, scale=2.0), ShapeContext(BOX), PUSHES)
    assert same == pytest.approx(mean)
    assert twice[:-1] == pytest.approx(2.0 * std[:-1], rel=1e-3)


def test_small_objects_have_wider_deviations_by_a_power(network: PushNetwork) -> None:
    """A box of a quarter of the size has the std in sizes times a power of how much smaller than the limit it is."""
    tiny = Outline.of(0.25 * BOX.corners)
    pushes = PUSHES[:3] * np.array([0.25, 0.25, 1.0, 0.25])
    context = ShapeContext(tiny, pusher_radius_m=0.001)
    mean, std = answer(ShapeNetwork(network), context, pushes)
    same, wider = answer(ShapeNetwork(network, small=0.5), context, pushes)
    assert same == pytest.approx(mean)
    assert wider == pytest.approx(std * (SMALL_M / tiny.size_m) ** 0.5, rel=0.02)
    assert tiny.size_m < SMALL_M


def test_the_answer_at_an_angle_of_pi_is_that_at_minus_pi(network: PushNetwork) -> None:
    """The cut of angles is nowhere in the answer."""
    start = np.array([[0.2, 0.004, math.pi, 0.2], [0.2, 0.004, -math.pi, 0.2]])
    mean, std = answer(ShapeNetwork(network), ShapeContext(BOX), start)
    assert mean[0] == pytest.approx(mean[1], abs=1e-5)
    assert std[0] == pytest.approx(std[1], abs=1e-5)


def drawn(count: int, seed: int) -> tuple[torch.Tensor, ...]:
    """Return pushes (n, 4), silhouettes, bodies and indices of boxes of 40 to 80 mm."""
    rng = np.random.default_rng(seed)
    corners = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    boxes = [ShapeContext(Outline.of(corners * rng.uniform(0.02, 0.04, 2))) for _ in range(count)]
    silhouette, _, _, body = (torch.from_numpy(part) for part in shape_tensors(*boxes))
    bearing = rng.uniform(-math.pi, math.pi, count)
    start = rng.uniform(0.06, 0.1, count)[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    pusher = np.column_stack([start, bearing + math.pi, rng.uniform(0.02, 0.08, count)]).astype(np.float32)
    return torch.from_numpy(pusher), silhouette, body, torch.arange(count)


def test_a_domain_knows_objects_and_pushes_like_those_of_its_training() -> None:
    """Boxes and pushes drawn alike are at most 1 away, a push ten times as long and a larger object are beyond."""
    domain = ShapeDomain().fit(*drawn(120, 0)).eval()
    pusher, silhouette, body, index = drawn(60, 1)
    found = domain(pusher, silhouette, body, index)
    assert (found <= 1.0).float().mean() > 0.95
    long = pusher * torch.tensor([1.0, 1.0, 1.0, 10.0])
    assert (domain(long, silhouette, body, index)[:, 0] > 1.0).all()
    large = body.clone()
    large[:, 2] *= 3.0
    assert (domain(pusher, silhouette, large, index)[:, 1] > 1.0).all()
    noise = torch.from_numpy(np.random.default_rng(2).uniform(-1.0, 1.0, silhouette.shape).astype(np.float32))
    assert (domain(pusher, noise, body, index)[:, 1] > 1.0).all()


def test_the_ranges_of_a_domain_are_named_with_units() -> None:
    """Every range has two ends in order, and a name for the manifest."""
    ranges = ShapeDomain().fit(*drawn(30, 0)).ranges()
    assert {"length_m", "length_over_size", "start_over_size", "size_m", "friction"} <= set(ranges)
    assert all(low <= high for low, high in ranges.values())
