"""The first contact in tensors is that of the service, also at its edges: corners, ends and filled-up outlines."""

import math

import numpy as np
import pytest
import shapely
import torch

from service.pushing.first_contact import first_contact as expected_contact
from service.pushing.outlines import Outline
from service.pushing.shape_context import CORNERS, ShapeContext
from training.networks.contact import FAR, LARGEST, Edges, OutlineEdges, clearance, first_contact

SQUARE = Outline.of([(0.03, 0.03), (-0.03, 0.03), (-0.03, -0.03), (0.03, -0.03)])
RADIUS_M = 0.005


def travel(x_m: float, y_m: float, angle_rad: float) -> float:
    """Return the travel of a tip to the square, in m, or inf."""
    start, ahead = torch.tensor([[[x_m, y_m]]]), torch.tensor([[[math.cos(angle_rad), math.sin(angle_rad)]]])
    size = SQUARE.size_m
    found = float(first_contact(edges_of_the_square(), start / size, ahead, torch.tensor([[[RADIUS_M / size]]])))
    return math.inf if found == LARGEST else found * size


def edges_of_the_square() -> Edges:
    """Return the edges of the square."""
    outline = torch.from_numpy(ShapeContext(SQUARE).tensors().outline[None])
    found: Edges = OutlineEdges()(outline, torch.zeros(1, 1, 2), torch.full((1, 1, 1), SQUARE.size_m))
    return found


@pytest.mark.parametrize(
    ("place", "angle"),
    [((-0.1, 0.0), 0.0), ((-0.1, 0.034), 0.0), ((-0.1, 0.0351), 0.0), ((-0.1, 0.1), -0.6), ((-0.1, 0.0), 3.0)],
    ids=["a side", "a corner", "just beside", "askew", "away"],
)
def test_the_travel_is_that_of_the_service(place: tuple[float, float], angle: float) -> None:
    """Sides, corners and misses have the travel of the closed form in float64."""
    expected = expected_contact(SQUARE, np.array([[*place, angle, math.inf]]), RADIUS_M).travel_m[0]
    assert travel(*place, angle) == pytest.approx(expected, abs=1e-6)


def test_a_tip_in_touch_does_not_travel() -> None:
    """A tip that touches or overlaps at the start is in contact, whatever its direction."""
    assert travel(-0.03 - RADIUS_M, 0.0, math.pi) == 0.0
    assert travel(-0.032, 0.0, 0.0) == 0.0


def test_edges_that_fill_an_outline_up_are_far_away() -> None:
    """An outline of four corners has four edges, and the other sixty are never near."""
    half = edges_of_the_square().half
    assert (half > 0.0).sum() == 4
    assert (half == -FAR).sum() == CORNERS - 4


def test_the_clearance_of_a_miss_is_the_distance_of_its_path() -> None:
    """Paths that pass by, end before the object or lead away have the distance that shapely measures."""
    rng = np.random.default_rng(0)
    outline = Outline.of([(0.05, -0.02), (0.05, 0.01), (0.01, 0.01), (0.01, 0.05), (-0.02, 0.05), (-0.02, -0.02)])
    corners = torch.from_numpy(ShapeContext(outline).tensors().outline[None])
    pushes = np.column_stack(
        [rng.uniform(-0.12, 0.12, (300, 2)), rng.uniform(-3.1, 3.1, 300), rng.uniform(0, 0.1, 300)]
    )
    polygon = shapely.Polygon(outline.corners)
    ends = pushes[:, :2] + pushes[:, 3:] * np.stack([np.cos(pushes[:, 2]), np.sin(pushes[:, 2])], axis=1)
    expected = np.array(
        [polygon.distance(shapely.LineString(ways)) for ways in np.stack([pushes[:, :2], ends], axis=1)]
    )
    pusher = torch.from_numpy(pushes.astype(np.float32))
    found = clearance(pusher, corners.expand(300, -1, -1), torch.full((300, 1), RADIUS_M))[:, 0].numpy()
    missing = expected > RADIUS_M
    assert 100 < missing.sum() < 300
    assert found[missing] == pytest.approx(expected[missing] - RADIUS_M, abs=1e-6)
