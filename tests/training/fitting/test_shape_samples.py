"""Samples of shapes: what is known of bodies is drawn, residuals lead back to outcomes, and splits are by objects."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from service.errors import DataError
from service.pushing.shape_context import FRICTION, PUSHER_RADIUS_M
from training.fitting.recipe import ALL_FAMILIES, DIFFERENT_FAMILIES
from training.fitting.shape_samples import (
    COPIES,
    HELD_OUT_FAMILIES,
    draw_known,
    mechanics_of,
    read_shapes,
    shape_batch,
    shape_samples,
    shape_training_data,
    split_shapes,
)
from training.networks.shape_features import PUSH_INPUTS
from training.tables.push_table import PushTable
from training.tables.reading import read_table


@pytest.fixture(scope="module")
def table(shapes_folder: Path) -> PushTable:
    """Read the small table of shapes."""
    return read_table(shapes_folder)


def families(table: PushTable) -> set[str]:
    """Return the families of the pushes of a table."""
    column = table.labels["family"]
    return {column.values[number] for number in np.unique(column.index)}


def test_values_that_are_not_known_are_the_defaults_of_the_service(table: PushTable) -> None:
    """A body of which nothing is known has the default friction and tip, and says that it does not know."""
    nothing = shape_batch(table, np.zeros((len(table.objects), 3), dtype=np.bool_)).contexts[-1]
    everything = shape_batch(table, np.ones((len(table.objects), 3), dtype=np.bool_)).contexts[-1]
    assert nothing[:, 3:5] == pytest.approx(nothing[:, 0:2])
    assert (nothing[:, [5, 8, 10]] == 0.0).all()
    assert nothing[:, 7] == pytest.approx(FRICTION)
    assert nothing[:, 9] == pytest.approx(PUSHER_RADIUS_M)
    assert (everything[:, [5, 8, 10]] == 1.0).all()
    assert everything[:, 7] == pytest.approx([item.friction for item in table.objects])


def test_a_centre_of_mass_off_the_centroid_is_known_more_often(table: PushTable) -> None:
    """Clients state a load that they know of, and each value is left out somewhere."""
    rng = np.random.default_rng(0)
    known = np.stack([draw_known(table, rng) for _ in range(100)])
    share = known.mean(axis=0)
    away = [np.hypot(*(np.array(item.centre_of_mass_m) - item.outline.centroid_m)) for item in table.objects]
    loaded = np.array(away) > 0.02 * np.array([item.outline.size_m for item in table.objects])
    assert share[loaded, 0].mean() == pytest.approx(0.85, abs=0.05)
    assert share[~loaded, 0].mean() == pytest.approx(0.4, abs=0.05)
    assert known[:, :, 0].any(axis=0).all()
    assert not known[:, :, 0].all(axis=0).any()


def test_a_friction_of_the_default_is_unknown_more_often_than_another_one(table: PushTable) -> None:
    """What a client leaves out is plain, so an answer without it is that for plain objects."""
    plain = replace(table, objects=tuple(replace(item, friction=FRICTION) for item in table.objects))
    rough = replace(table, objects=tuple(replace(item, friction=0.9) for item in table.objects))
    rng = np.random.default_rng(0)
    shares = [np.mean([draw_known(each, rng)[:, 1] for _ in range(100)]) for each in (plain, rough)]
    assert shares[0] == pytest.approx(0.25, abs=0.03)
    assert shares[1] > 0.95


def test_a_value_that_a_table_does_not_have_is_never_known(table: PushTable) -> None:
    """A table without friction has no object of a known friction."""
    bare = replace(table, objects=tuple(replace(item, friction=None) for item in table.objects))
    rng = np.random.default_rng(0)
    assert not any(draw_known(bare, rng)[:, 1].any() for _ in range(20))
    assert (shape_batch(bare, np.ones((len(bare.objects), 3), dtype=np.bool_)).contexts[-1][:, 8] == 0.0).all()


def test_samples_are_by_object_and_pushes_that_miss_are_left_out(table: PushTable) -> None:
    """Inputs and residuals are of the same pushes, and the valid ones are those that touch."""
    known = draw_known(table, np.random.default_rng(0))
    found = shape_samples(table, [known, ~known], quiet=True)
    touches = mechanics_of(shape_batch(table, known), quiet=True).touches
    assert found.inputs.shape == (2 * len(table.objects), 20, PUSH_INPUTS)
    assert found.targets.shape == (2 * len(table.objects), 20, 3)
    assert float(found.valid[: len(table.objects)].sum()) == float(touches.sum())
    assert 0.6 < float(touches.mean()) < 1.0
    assert all(torch.isfinite(part).all() for part in (found.inputs, found.targets, found.context))
    moved = found.targets[found.valid > 0.0]
    assert float(moved.abs().median()) < 1.0  # the unit of residuals is that of their scatter


def test_families_are_held_out_whole(table: PushTable) -> None:
    """No family that is never seen is trained on, and held-out objects are of the families seen."""
    split = split_shapes(table, DIFFERENT_FAMILIES)
    assert split.unseen is not None
    assert families(split.unseen) == set(HELD_OUT_FAMILIES)
    assert not families(split.train) & set(HELD_OUT_FAMILIES)
    assert families(split.held_out) <= families(split.train)
    assert not {item.name for item in split.train.objects} & {item.name for item in split.held_out.objects}


def test_all_families_are_trained_on_if_asked(table: PushTable) -> None:
    """A set-up with all families has held-out objects only."""
    split = split_shapes(table, ALL_FAMILIES)
    assert split.unseen is None
    assert set(HELD_OUT_FAMILIES) <= families(split.train)
    assert split.train.count + split.held_out.count == table.count


def test_training_data_have_each_object_in_copies(shapes_folder: Path) -> None:
    """Objects enter the training in copies with other parts known, and held-out objects once."""
    table, split = read_shapes(shapes_folder, DIFFERENT_FAMILIES)
    data = shape_training_data(table, split, 0, quiet=True)
    assert len(data.train.context) == COPIES * len(split.train.objects)
    assert data.held_out is not None
    assert len(data.held_out.context) == len(split.held_out.objects)
    assert data.origin == {"source": table.source, "sha256": table.digest}


def test_a_table_of_one_object_is_refused(table: PushTable) -> None:
    """There is nothing to hold out, and the error says so."""
    with pytest.raises(DataError, match="2 objects"):
        split_shapes(table.select(table.object_index == 0), ALL_FAMILIES)
