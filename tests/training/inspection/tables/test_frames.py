"""Units and frames: each wrong reading of the same pushes is named with the remedy."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angles
from tests.training.tables.tables import WEDGE, pushed_table
from training.inspection.findings import Severity
from training.inspection.tables.frames import odd_frames, odd_units
from training.inspection.tables.geometry import push_geometry
from training.tables.push_table import PushTable

Change = Callable[[PushTable], PushTable]


@pytest.fixture(scope="module")
def table() -> PushTable:
    """Pushes of an object without symmetry about its centroid, in which no other frame looks the same."""
    wedge = Outline.of(WEDGE)
    return pushed_table({"wedge": Outline.of(wedge.corners - wedge.centroid_m)}, 80)


def messages(table: PushTable) -> list[str]:
    """Return the messages about units, or about frames if there are none about units."""
    found = list(odd_units("here", table)) or list(odd_frames("here", table, push_geometry(table)))
    assert all(each.severity is Severity.ERROR for each in found)
    return [each.message for each in found]


def scaled(pushers: tuple[float, ...], outcomes: tuple[float, ...]) -> Change:
    """Return the change of a table by factors of its columns."""
    return lambda table: replace(table, pushers=table.pushers * pushers, outcomes=table.outcomes * outcomes)


def angles(change: Callable[[DoubleArray], DoubleArray]) -> Change:
    """Return the change of a table by its push angles."""

    def changed(table: PushTable) -> PushTable:
        pushers = table.pushers.copy()
        pushers[:, 2] = wrap_angles(change(pushers[:, 2]))
        return replace(table, pushers=pushers)

    return changed


def turned(table: PushTable) -> PushTable:
    """Return the table with outlines turned by -90 degrees."""
    corners = table.objects[0].outline.corners @ [[0.0, -1.0], [1.0, 0.0]]
    return replace(table, objects=(replace(table.objects[0], outline=Outline.of(corners)),))


def shifted(table: PushTable) -> PushTable:
    """Return the table with the origin of the outlines in a corner of the box around them."""
    outline = table.objects[0].outline
    moved = Outline.of(outline.corners - outline.corners.min(axis=0))
    return replace(table, objects=(replace(table.objects[0], outline=moved),))


def swapped(table: PushTable) -> PushTable:
    """Return the table with x and y exchanged in the pushes."""
    pushers = table.pushers[:, [1, 0, 2, 3]]
    pushers[:, 2] = wrap_angles(math.pi / 2 - pushers[:, 2])
    return replace(table, pushers=pushers, outcomes=table.outcomes[:, [1, 0, 2]] * (1, 1, -1))


def test_pushes_in_metres_in_the_frame_of_the_outline_have_no_finding(table: PushTable) -> None:
    """Return no message for a table without a fault, so that every message below comes from its change."""
    assert messages(table) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        pytest.param(scaled((1e3, 1e3, 1, 1e3), (1e3, 1e3, 1)), "pusher_x_m and pusher_y_m look like mill", id="mm"),
        pytest.param(scaled((100, 100, 1, 100), (100, 100, 1)), "pusher_x_m and pusher_y_m look like cent", id="cm"),
        pytest.param(scaled((1, 1, 1, 1e3), (1, 1, 1)), "push_length_m looks like millimetres", id="mm of length"),
        pytest.param(scaled((1, 1, 1, 1), (1e3, 1e3, 1)), "object_x_m and object_y_m look like mill", id="mm after"),
        pytest.param(scaled((1, 1, 180 / math.pi, 1), (1, 1, 1)), "push_angle_rad looks like degrees", id="degrees"),
        pytest.param(scaled((1, 1, 1, 1), (1, 1, 180 / math.pi)), "object_yaw_rad looks like degrees", id="yaw"),
    ],
)
def test_other_units_are_named(table: PushTable, change: Change, words: str) -> None:
    """Name the column, its unit, and the number to divide by or to multiply with."""
    found = messages(change(table))
    assert words in found[0]
    assert "divide them by" in found[0] or "multiply by" in found[0]


def test_small_objects_in_centimetres_are_named(table: PushTable) -> None:
    """Name centimetres throughout, of an object so small that its outline passes for one in metres."""
    outline = Outline.of(table.objects[0].outline.corners * 10.0)
    objects = (replace(table.objects[0], outline=outline),)
    (found,) = messages(replace(table, objects=objects, pushers=table.pushers * (10, 10, 1, 30)))
    assert "outlines and pushes look like centimetres (pushes of 1.5 m)" in found


def test_outcomes_in_the_world_are_named(table: PushTable) -> None:
    """Name poses after the push that are not in the object's frame before it."""
    (found,) = messages(replace(table, outcomes=table.outcomes + np.array([0.5, 0.2, 0.0])))
    assert "object_x_m and object_y_m look like world coordinates" in found


@pytest.mark.parametrize(
    ("change", "words"),
    [
        pytest.param(angles(lambda angle: angle + math.pi), "add pi", id="from object to pusher"),
        pytest.param(angles(np.negative), "push_angle_rad turns clockwise", id="clockwise"),
        pytest.param(angles(lambda angle: math.pi / 2 - angle), "from the y axis, clockwise", id="compass"),
        pytest.param(scaled((1, -1, -1, 1), (1, -1, -1)), "the y axis is flipped", id="y down"),
        pytest.param(scaled((1, 1, 1, 1), (1, 1, -1)), "object_yaw_rad changes its sign", id="yaw"),
        pytest.param(scaled((1, 1, 1, 1), (-1, -1, 1)), "object_x_m and object_y_m change their signs", id="motion"),
        pytest.param(swapped, "x and y are swapped", id="swapped"),
        pytest.param(turned, "turned by 270 degrees", id="turned"),
        pytest.param(shifted, "about the centroid", id="shifted"),
    ],
)
def test_the_frame_that_fits_is_named(table: PushTable, change: Change, words: str) -> None:
    """Try simple other frames, and name the one in which the pushes are possible."""
    (found,) = messages(change(table))
    assert "impossible beside the outlines" in found
    assert words in found


def test_shuffled_rows_fit_no_frame(table: PushTable) -> None:
    """Say that rows may be shuffled, as after sorting one column, if no frame fits."""
    (found,) = messages(replace(table, outcomes=table.outcomes[::-1]))
    assert "rows are not shuffled" in found
