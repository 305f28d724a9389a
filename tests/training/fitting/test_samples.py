"""Samples: pushes normalised by object, with the contexts of a kind, and the data of a run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from service.errors import DataError
from service.model.tensors import ContextKind
from service.pushing.contexts import VisualContext
from training.fitting.samples import Samples, TrainingData, contexts, read_pushes, read_training_data
from training.omnipush.declaration import declare_dataset
from training.omnipush.published import Split, different_objects, published_normalisation
from training.omnipush.pushes import Pushes, read_folder, write_object
from training.simulation.drawing import write_camera_views, write_views


@pytest.fixture(scope="module")
def pushes(data_folder: Path) -> Pushes:
    """The synthetic pushes of all 250 objects."""
    return read_folder(data_folder)


def test_pushes_are_normalised_with_the_published_statistics() -> None:
    """A pose at the published mean becomes zeros, and one a deviation away becomes ones. Padding is kept."""
    known = published_normalisation()
    pushers = np.array([[known.input_mean, known.input_mean + known.input_std]], dtype=np.float32)
    outcomes = np.array([[known.output_mean - known.output_std, known.output_mean]], dtype=np.float32)
    pushes = Pushes(("1a2b3c4a",), pushers, outcomes, np.array([[1.0, 0.0]], dtype=np.float32), "a test", "0" * 64)

    found = Samples.of(pushes, ContextKind.INDICATOR)
    assert found.inputs[0].numpy() == pytest.approx(np.array([[0.0] * 3, [1.0] * 3]), abs=1e-6)
    assert found.targets[0].numpy() == pytest.approx(np.array([[-1.0] * 3, [0.0] * 3]), abs=1e-6)
    assert found.valid.tolist() == [[1.0, 0.0]]
    assert (found.context.numpy() == pushes.indicators).all()
    assert found.target_std == tuple(known.output_std)
    tensors = (found.inputs, found.targets, found.valid, found.context)
    assert {tensor.dtype for tensor in tensors} == {torch.float32}


def test_contexts_are_of_the_given_kind(viewed_pushes: Pushes) -> None:
    """Contexts are empty, 36 indicator values, or a view in 0..1 with the numbers that the service feeds its models."""
    assert viewed_pushes.views is not None
    assert contexts(viewed_pushes, ContextKind.NONE).shape == (250, 0)
    assert (contexts(viewed_pushes, ContextKind.INDICATOR) == viewed_pushes.indicators).all()
    served = VisualContext.from_bytes(viewed_pushes.views[17].tobytes()).tensor()
    assert (contexts(viewed_pushes, ContextKind.VISUAL)[17] == served).all()


def test_visual_contexts_need_views(pushes: Pushes) -> None:
    """Visual contexts of pushes that were read without views are refused."""
    with pytest.raises(DataError, match="read without top-down views"):
        contexts(pushes, ContextKind.VISUAL)


def test_a_selection_keeps_its_order(viewed_pushes: Pushes) -> None:
    """Selecting objects takes the same rows, in the given order, of every tensor."""
    samples = Samples.of(viewed_pushes, ContextKind.VISUAL)
    found = samples.select(torch.tensor([7, 3]))

    for name in ("inputs", "targets", "valid", "context"):
        assert torch.equal(getattr(found, name)[0], getattr(samples, name)[7])
        assert torch.equal(getattr(found, name)[1], getattr(samples, name)[3])
    assert found.target_std == samples.target_std


def test_samples_taken_singly_keep_their_contexts() -> None:
    """Single samples become objects of their own, in order and without padding, with their object's context."""
    numbers = torch.arange(6.0).reshape(2, 3)
    valid = torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0]])
    context = torch.tensor([[7.0], [8.0]])
    single = Samples(numbers[..., None], -numbers[..., None], valid, context, (2.0,)).singly()

    assert single.inputs.tolist() == [[[0.0]], [[1.0]], [[2.0]], [[3.0]], [[5.0]]]
    assert single.targets.flatten().tolist() == [0.0, -1.0, -2.0, -3.0, -5.0]
    assert single.valid.tolist() == [[1.0]] * 5
    assert single.context.tolist() == [[7.0], [7.0], [7.0], [8.0], [8.0]]
    assert single.target_std == (2.0,)


def test_training_data_are_the_split_s(pushes: Pushes) -> None:
    """Training data are the split's 200 and 50 objects, with source and digest of the pushes."""
    data = TrainingData.of(different_objects(), ContextKind.INDICATOR, pushes)

    assert (len(data.train.context), len(data.held_out.context)) == (200, 50)
    assert (data.train.context.numpy() == pushes.select(different_objects().train).indicators).all()
    assert data.origin == {"source": pushes.source, "sha256": pushes.digest}


def write_pushes(folder: Path, descriptors: tuple[str, ...], x_m: float) -> None:
    """Write objects whose pushes all move them by ``x_m``."""
    declare_dataset(folder, {"source": f"pushes of a test, {folder.name}"})
    for descriptor in descriptors:
        write_object(folder, descriptor, np.full((2, 3), 0.05), np.full((2, 3), x_m))


def test_another_surface_is_read_from_the_folder_beside(tmp_path: Path) -> None:
    """Held-out objects on another surface are read from the sibling folder, and the record names both folders."""
    split = Split("a test", ("1a1a1a1a", "1a1a1a2a"), ("1a1a1a2a",), test_surface="plywood")
    write_pushes(tmp_path / "abs", split.train, 0.01)
    write_pushes(tmp_path / "plywood", split.test, 0.03)

    data = read_training_data(split, ContextKind.INDICATOR, tmp_path / "abs")

    known = published_normalisation()
    expected = ((0.03 - known.output_mean) / known.output_std).tolist()
    assert data.held_out.targets[0, 0].tolist() == pytest.approx(expected, rel=1e-5)
    assert (len(data.train.context), len(data.held_out.context)) == (2, 1)
    assert data.origin["source"] == "pushes of a test, abs"
    assert data.origin["held_out_source"] == "pushes of a test, plywood"
    assert data.origin["held_out_sha256"] != data.origin["sha256"]


def test_a_missing_surface_is_named(tmp_path: Path) -> None:
    """A missing folder of the other surface is named before any training."""
    split = Split("a test", ("1a1a1a1a",), ("1a1a1a1a",), test_surface="plywood")
    write_pushes(tmp_path / "abs", split.train, 0.01)

    with pytest.raises(DataError, match="plywood is not a folder of pushes"):
        read_training_data(split, ContextKind.INDICATOR, tmp_path / "abs")


def test_views_are_read_from_the_folder_beside_or_a_given_one(tmp_path: Path) -> None:
    """Views are read for the pushed objects and enter the digest, so that other views are other data."""
    write_pushes(tmp_path / "abs", ("1a1a1a1a", "1b1a1a3a"), 0.01)
    write_views(tmp_path / "top-down_view", ("1a1a1a1a", "1b1a1a3a"), quiet=True)
    write_views(tmp_path / "camera", ("1a1a1a1a", "1b1a1a3a"), camera=True, quiet=True)

    plain = read_pushes(tmp_path / "abs", ContextKind.INDICATOR)
    beside = read_pushes(tmp_path / "abs", ContextKind.VISUAL)
    named = read_pushes(tmp_path / "abs", ContextKind.VISUAL, tmp_path / "camera")

    assert plain.views is None
    assert beside.views is not None
    assert beside.views.shape == (2, 1, 32, 32)
    assert len({plain.digest, beside.digest, named.digest}) == 3


def test_camera_views_are_read_from_the_folder_beside_the_drawings(tmp_path: Path) -> None:
    """Samples show the drawing first and then the camera views, which enter the digest too."""
    names = ("1a1a1a1a", "1b1a1a3a")
    write_pushes(tmp_path / "abs", names, 0.01)
    write_views(tmp_path / "top-down_view", names, quiet=True)
    write_camera_views(tmp_path / "top-down_view-cameras", names, 2, quiet=True)

    found = read_pushes(tmp_path / "abs", ContextKind.VISUAL, camera_views=2)
    samples = Samples.of(found.select(names[::-1]), ContextKind.VISUAL)

    assert found.camera_views is not None
    assert found.digest != read_pushes(tmp_path / "abs", ContextKind.VISUAL).digest
    assert samples.views is not None
    assert samples.views.shape == (2, 3, 1, 32, 32)
    assert torch.equal(samples.seen(torch.tensor([0, 0])).context, samples.context)
    seen = samples.seen(torch.tensor([2, 1])).context
    assert torch.equal(seen[0], torch.from_numpy(found.camera_views[1, 1] / np.float32(255.0)))
    assert torch.equal(samples.select(torch.tensor([1])).seen(torch.tensor([1])).context[0], seen[1])
    with pytest.raises(DataError, match="without camera views"):
        Samples.of(found, ContextKind.INDICATOR).seen(torch.tensor([0, 0]))


def test_selecting_objects_selects_their_views(viewed_pushes: Pushes) -> None:
    """Selecting objects selects their views and keeps the digest, and other views give another digest."""
    assert viewed_pushes.views is not None
    names = (viewed_pushes.descriptors[9], viewed_pushes.descriptors[2])
    found = viewed_pushes.select(names)

    assert found.views is not None
    assert (found.views == viewed_pushes.views[[9, 2]]).all()
    assert found.digest == viewed_pushes.digest
    other = replace(viewed_pushes, digest="0").with_views(255 - viewed_pushes.views)
    assert other.digest != replace(viewed_pushes, digest="0").with_views(viewed_pushes.views).digest
