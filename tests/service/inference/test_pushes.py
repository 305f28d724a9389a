"""Pushes as rows of a model: lengths, and starts inside of shapes."""

import numpy as np
import pytest

from service.errors import InvalidRequestError
from service.inference.pushes import PushFields, push_rows, reach_m, starts_inside
from service.inference.query import ContextBatch
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind
from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from tests.fakes import all_fake_models
from tests.served_graphs import BOX, L_SHAPE, shape_tensors

FIELDS = PushFields("pushers.{row}", "lengths.{row}", first_row=10)
NONE = ContextBatch(ContextKind.NONE, (), None, "contexts")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[ContextKind, LoadedModel]:
    """Return a fake model without context and one of shapes."""
    _, models = all_fake_models(tmp_path_factory.mktemp("models"))
    return {kind: models.snapshot.find_default(kind) for kind in (ContextKind.NONE, ContextKind.SHAPE)}


def shapes(*outlines: Outline, index: list[int]) -> ContextBatch:
    """Return the contexts of outlines."""
    tensors = shape_tensors(*map(ShapeContext, outlines))
    return ContextBatch(ContextKind.SHAPE, tensors, np.array(index), "contexts")


def test_a_model_of_shapes_gets_lengths_and_others_do_not(models: dict[ContextKind, LoadedModel]) -> None:
    """Rows have four columns, with one length for all or each its own, or three columns."""
    poses = np.array([[-0.1, 0.0, 0.5], [0.1, 0.0, 3.0]])
    contexts = shapes(BOX, index=[0, 0])
    for lengths, found in (([0.02], [0.02, 0.02]), ([0.02, 0.1], [0.02, 0.1])):
        rows = push_rows(models[ContextKind.SHAPE], poses, np.array(lengths), contexts, FIELDS)
        assert rows.dtype == np.float32
        assert rows == pytest.approx(np.column_stack([poses, found]))
    rows = push_rows(models[ContextKind.NONE], poses, np.array([0.05]), NONE, FIELDS)
    assert rows == pytest.approx(poses)


def test_a_model_of_one_length_refuses_others_by_its_name(models: dict[ContextKind, LoadedModel]) -> None:
    """The error names the first push, its length, the model and the cure."""
    poses, lengths = np.zeros((3, 3)), np.array([0.05, 0.02, 0.1])
    with pytest.raises(InvalidRequestError) as caught:
        push_rows(models[ContextKind.NONE], poses, lengths, NONE, FIELDS)
    (fault,) = caught.value.faults
    assert (fault.where, fault.received) == ("lengths.11", "0.02 m")
    assert "push-none" in fault.accepted
    assert "outline" in fault.accepted


def test_a_pusher_that_starts_inside_of_its_own_shape_is_refused(models: dict[ContextKind, LoadedModel]) -> None:
    """Each push is compared with its own object, and the first one inside is named."""
    poses = np.array([[0.03, 0.03, 0.0], [0.03, 0.03, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(InvalidRequestError, match=r"^pushers\.11: received a pusher that starts inside"):
        push_rows(models[ContextKind.SHAPE], poses, np.array([0.05]), shapes(BOX, L_SHAPE, index=[1, 0, 0]), FIELDS)
    push_rows(models[ContextKind.SHAPE], poses[:1], np.array([0.05]), shapes(L_SHAPE, index=[0]), FIELDS)


def test_points_are_inside_as_the_outline_says() -> None:
    """Thousands of points, in several parts, are judged as the geometry of outlines judges them one by one."""
    angles = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    star = Outline.of(np.stack([np.cos(angles), np.sin(angles)], axis=1) * (0.05 + 0.02 * np.sin(5 * angles))[:, None])
    contexts = shapes(star, L_SHAPE, index=[])
    rng = np.random.default_rng(0)
    poses, index = rng.uniform(-0.08, 0.08, (3000, 3)), rng.integers(0, 2, 3000)
    found = starts_inside(contexts.tensors[1], index, poses)
    for number in range(2):
        seen = Outline(contexts.tensors[1][number].astype(np.float64))  # with 64 corners, as a graph sees it
        assert (found[index == number] == seen.contains(poses[index == number, :2])).all()
    assert 0.1 < found.mean() < 0.9


def test_shapes_have_a_longer_reach() -> None:
    """The frame of a shape is the caller's, and that of another object lies in its middle."""
    assert (reach_m(ContextKind.SHAPE), reach_m(ContextKind.INDICATOR)) == (10.0, 1.0)
