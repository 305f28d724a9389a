"""Replay of a table: the same pushes, with the seed alone deciding, and what is known of an object used."""

from dataclasses import replace

import numpy as np
import pytest

from service.errors import DataError
from service.pushing.outlines import Outline
from training.simulation.bodies import RECORDED
from training.simulation.replay import replay, replay_even
from training.tables.push_table import PushTable, TableObject

BOX = Outline.of([(-0.04, -0.03), (0.04, -0.03), (0.04, 0.03), (-0.04, 0.03)])
THROUGH_THE_CENTRE = (-0.045, 0.0, 0.0, 0.05)
ASIDE = (-0.045, 0.02, 0.0, 0.05)
MISS = (-0.045, 0.2, 0.0, 0.05)


def table(item: TableObject | None = None, surface: str = "abs") -> PushTable:
    """Return a table of three pushes of a box."""
    return PushTable(
        objects=(item or TableObject("box", BOX),),
        object_index=np.zeros(3, dtype=np.int64),
        pushers=np.array([THROUGH_THE_CENTRE, ASIDE, MISS]),
        outcomes=np.zeros((3, 3)),
        pusher_radius_m=np.array([0.005, 0.005, 0.005]),
        surfaces=(surface,),
        surface_index=np.zeros(3, dtype=np.int64),
        source="test",
        digest="",
    )


def test_the_seed_decides_the_replay() -> None:
    """The same seed gives the same bytes, another one other outcomes, and draws differ."""
    first, again, other = (replay(table(), seed, 3) for seed in (1, 1, 2))

    assert first.shape == (3, 3, 3)
    assert first.tobytes() == again.tobytes()
    assert (first[:, :2] != other[:, :2]).all()
    assert (first[0, :2] != first[1, :2]).all()


def test_a_draw_does_not_depend_on_the_number_of_draws() -> None:
    """The first two of three draws are those that two draws alone have."""
    assert replay(table(), 5, 3)[:2].tobytes() == replay(table(), 5, 2).tobytes()


def test_draws_scatter_around_the_push_without_variation() -> None:
    """The mean of many draws is close to it, and a miss stays where it is but for the tracker's noise."""
    even, draws = replay_even(table()), replay(table(), 1, 60)

    assert (np.abs(draws.mean(axis=0) - even).max(axis=0) < (0.005, 0.005, 0.06)).all()
    assert np.abs(even[0] - (0.05, 0.0, 0.0)).max() < 1e-3
    assert even[2] == pytest.approx([0.0, 0.0, 0.0], abs=0.0)
    assert np.abs(draws[:, 2]).max() < 2e-3
    assert 1e-4 < draws[:, 1, :2].std(axis=0).max() < 0.02


def test_a_known_centre_of_mass_and_friction_are_used() -> None:
    """Both change the outcome of a push off the centre."""
    plain = replay_even(table())
    heavy = replay_even(table(TableObject("box", BOX, centre_of_mass_m=(0.0, 0.02))))
    slippery = replay_even(table(TableObject("box", BOX, friction=0.05)))

    assert abs(heavy[1, 2]) < 0.1 * abs(plain[1, 2])
    assert not np.allclose(slippery[1], plain[1], atol=1e-4)


def test_a_centre_of_mass_outside_names_the_object() -> None:
    """One line says which object, and what to do."""
    outside = TableObject("box", BOX, centre_of_mass_m=(0.1, 0.0))
    for way in (replay_even, lambda pushes: replay(pushes, 0, 1)):
        with pytest.raises(DataError, match=r"object 'box' .* centre of mass lies outside of the outline; correct it"):
            way(table(outside))


def test_a_plate_spreads_the_weight_in_its_own_way() -> None:
    """A box that stands on its rim turns less than one that bears evenly."""
    turns = [abs(replay_even(table(surface=name))[1, 2]) for name in ("plywood", "abs")]

    assert turns[0] < 0.95 * turns[1]


def test_on_an_unknown_plate_the_spread_is_drawn_for_each_draw() -> None:
    """Without any variation from push to push, draws differ by the body alone."""
    same = replace(
        RECORDED, contact_spread=0.0, roughness=0.0, misplaced_m=0.0, misplaced_rad=0.0, tracker_std=(0, 0, 0)
    )

    assert np.ptp(replay(table(), 1, 4, same)[:, 1, 2]) == 0.0
    assert np.ptp(replay(table(surface="unstated"), 1, 8, same)[:, 1, 2]) > 0.01
