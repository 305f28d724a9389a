"""Augmentation: symmetric scenes and pushes without contact are those that the simulator would have added."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch
from mujoco import rollout

from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext
from service.pushing.images import GreyImage, visual_context
from service.pushing.poses import PUSH_LENGTH_M
from training.fitting.augmentation import (
    FURTHEST_START_M,
    OBJECT_REACH_M,
    augmented,
    in_symmetric_frames,
    no_contact_pushers,
)
from training.fitting.samples import Samples
from training.omnipush.published import published_normalisation
from training.omnipush.pushes import Pushes
from training.simulation.drawing import top_down_view
from training.simulation.plans import sample_pushers
from training.simulation.scene import PUSHER_RADIUS_M, push_object
from training.simulation.solids import solid
from training.simulation.surfaces import Array, even_conditions

# every shape and weight, on no two sides the same
OBJECTS = ("1a2C3b4a", "2B1b4c3a", "4b4a2a1c")
SYMMETRIES = [
    pytest.param(quarters, mirrored, id=f"{'mirrored and ' if mirrored else ''}turned by {90 * quarters} degrees")
    for mirrored in (0, 1)
    for quarters in range(4)
]
# Symmetric scenes differ by the rounding of float32 (1e-7 relative), which the solver may amplify.
SAME_M_AND_RAD = np.array([2e-5, 2e-5, 2e-4])
PUSHES = 6


def simulate(descriptor: str, pushers: Array) -> Array:
    """Simulate true outcomes on an even table."""
    body = solid(ObjectContext.from_descriptor(descriptor))
    with rollout.Rollout(nthread=1) as pool:
        return push_object(body, pushers, even_conditions(len(pushers)), pool, 1)


def view_of(context: ObjectContext) -> npt.NDArray[np.uint8]:
    """Draw the 32 x 32 levels of an object, (1, 32, 32)."""
    levels = visual_context(GreyImage.from_array(top_down_view(context), "view")).levels
    return np.frombuffer(levels, dtype=np.uint8).reshape(1, 32, 32)


@pytest.fixture(scope="module")
def scenes() -> Pushes:
    """Simulate pushes of the objects, rounded to float32 as files hold them, with views."""
    rng, contexts = np.random.default_rng(3), [ObjectContext.from_descriptor(name) for name in OBJECTS]
    pushers = np.stack([sample_pushers(solid(context), PUSHES, rng) for context in contexts]).astype(np.float32)
    outcomes = np.stack(
        [simulate(name, poses.astype(np.float64)) for name, poses in zip(OBJECTS, pushers, strict=True)]
    )
    views = np.stack([view_of(context) for context in contexts])
    valid = np.ones((len(OBJECTS), PUSHES), dtype=np.float32)
    return Pushes(OBJECTS, pushers, outcomes.astype(np.float32), valid, "a test", "").with_views(views)


@pytest.fixture(scope="module")
def samples(scenes: Pushes) -> Samples:
    """Normalise the scenes, with indicators."""
    return Samples.of(scenes, ContextKind.INDICATOR)


def with_symmetry(samples: Samples, quarters: int, mirrored: int) -> Samples:
    """Change all objects by one symmetry."""
    objects = len(samples.inputs)
    return in_symmetric_frames(samples, torch.full((objects,), quarters), torch.full((objects,), mirrored))


def mirror_image(context: ObjectContext) -> ObjectContext:
    """Swap sides 2 and 4 of an object's descriptor."""
    text = context.descriptor()
    return ObjectContext.from_descriptor(text[:2] + text[6:] + text[4:6] + text[2:4])


def in_si(samples: Samples) -> tuple[Array, Array]:
    """Return pushers and outcomes (objects, pushes, 3) in SI units."""
    return published_normalisation().in_si(
        samples.inputs.numpy().astype(np.float64), samples.targets.numpy().astype(np.float64)
    )


@pytest.mark.parametrize(("quarters", "mirrored"), SYMMETRIES)
def test_a_symmetric_scene_is_one_of_the_simulator(samples: Samples, quarters: int, mirrored: int) -> None:
    """Simulating the changed push of the changed object gives the changed outcome."""
    found = with_symmetry(samples, quarters, mirrored)
    pushers, outcomes = in_si(found)

    for place, indicator in enumerate(found.context.numpy()):
        simulated = simulate(ObjectContext.from_indicator(indicator).descriptor(), pushers[place])
        assert np.abs(simulated[:, :2]).max() > 0.005, "the pushes move the object"
        assert (np.abs(simulated - outcomes[place]) < SAME_M_AND_RAD).all()


@pytest.mark.parametrize(("quarters", "mirrored"), SYMMETRIES)
def test_indicators_follow_the_object(samples: Samples, quarters: int, mirrored: int) -> None:
    """The changed indicator is the indicator of the mirrored and turned object."""
    for name, found in zip(OBJECTS, with_symmetry(samples, quarters, mirrored).context.numpy(), strict=True):
        context = ObjectContext.from_descriptor(name)
        expected = (mirror_image(context) if mirrored else context).turned(quarters)
        assert ObjectContext.from_indicator(found) == expected


@pytest.mark.parametrize(("quarters", "mirrored"), SYMMETRIES)
def test_views_follow_the_object(scenes: Pushes, quarters: int, mirrored: int) -> None:
    """The changed view is the view drawn of the changed object, up to the rounding of its levels."""
    samples = Samples.of(scenes, ContextKind.VISUAL)

    for name, found in zip(OBJECTS, with_symmetry(samples, quarters, mirrored).context.numpy(), strict=True):
        context = ObjectContext.from_descriptor(name)
        expected = view_of((mirror_image(context) if mirrored else context).turned(quarters))
        assert np.abs(255.0 * found - expected).max() < 1.5


@pytest.mark.parametrize("kind", list(ContextKind))
@pytest.mark.parametrize(("times", "quarters", "mirrored"), [(4, 1, 0), (2, 2, 0), (2, 0, 1), (2, 3, 1)])
def test_symmetries_undo_themselves(
    scenes: Pushes, kind: ContextKind, times: int, quarters: int, mirrored: int
) -> None:
    """Four quarter turns, two half turns or two mirrors about any axis give the original samples."""
    samples = Samples.of(scenes, kind)
    found = samples
    for _ in range(times):
        found = with_symmetry(found, quarters, mirrored)

    assert torch.allclose(found.inputs, samples.inputs, atol=1e-5)
    assert torch.allclose(found.targets, samples.targets, atol=1e-5)
    assert torch.equal(found.context, samples.context)


def test_each_object_has_its_own_symmetry(samples: Samples) -> None:
    """The symmetry of one object in a batch does not affect the other objects."""
    together = in_symmetric_frames(samples, torch.tensor([0, 1, 3]), torch.tensor([0, 1, 0]))

    for place, (quarters, mirrored) in enumerate([(0, 0), (1, 1), (3, 0)]):
        alone = with_symmetry(samples.select(torch.tensor([place])), quarters, mirrored)
        assert torch.allclose(together.inputs[place], alone.inputs[0], atol=1e-6)
        assert torch.allclose(together.targets[place], alone.targets[0], atol=1e-6)
        assert torch.equal(together.context[place], alone.context[0])


def test_angles_stay_wrapped(samples: Samples) -> None:
    """Changed angles stay in (-pi, pi], as a file would hold them."""
    for quarters in range(4):
        pushers, outcomes = in_si(with_symmetry(samples, quarters, 1))
        assert np.abs(pushers[..., 2]).max() <= math.pi + 1e-6
        assert np.abs(outcomes[..., 2]).max() < 1.5


def test_pushers_without_contact_stay_out_of_reach() -> None:
    """Paths without contact start between Omnipush's starts and 0.3 m and stay out of reach. Some lead inwards."""
    pushers = no_contact_pushers(5_000, np.random.default_rng(1))
    start, direction = pushers[:, :2], np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])])
    path = start[:, None] + np.linspace(0.0, PUSH_LENGTH_M, 201)[:, None] * direction[:, None]
    inwards = (start * direction).sum(-1) < 0.0

    assert np.hypot(*path.T).min() >= OBJECT_REACH_M - 1e-6
    assert np.hypot(*start.T).max() < FURTHEST_START_M
    assert 0.1 < inwards.mean() < 0.5
    assert np.abs(pushers[:, 2]).max() <= math.pi


@pytest.mark.parametrize("shape", "1234")
def test_no_object_reaches_beyond_the_reach(shape: str) -> None:
    """The furthest corner of each shape plus the pusher's radius lies within ``OBJECT_REACH_M``."""
    corners = np.concatenate(solid(ObjectContext.from_descriptor(4 * f"{shape}a")).pieces)

    assert np.hypot(*corners.T).max() + PUSHER_RADIUS_M < OBJECT_REACH_M


@pytest.mark.parametrize("descriptor", ["2a2a2a2a", "4a4a4a4a", "1c1a3b2C"])
def test_pushers_without_contact_miss_in_the_simulator(descriptor: str) -> None:
    """Simulated pushes without contact move the object by no more than its settling at rest."""
    outcomes = simulate(descriptor, no_contact_pushers(60, np.random.default_rng(2)))

    assert np.abs(outcomes).max() < 1e-6


def test_a_share_of_the_pushes_has_no_contact(samples: Samples) -> None:
    """The given share of pushes has no contact and no motion. Other pushes, contexts and padding stay the same."""
    many = samples.select(torch.arange(300) % len(OBJECTS))
    found = augmented(many, symmetries=False, no_contact=0.25, rng=np.random.default_rng(4))
    replaced = (found.inputs != many.inputs).any(-1)
    _, outcomes = in_si(found)

    assert float(replaced.float().mean()) == pytest.approx(0.25, abs=0.04)
    assert np.abs(outcomes[replaced.numpy()]).max() < 1e-7
    assert torch.equal(found.targets[~replaced], many.targets[~replaced])
    assert found.context is many.context
    assert found.valid is many.valid


def test_without_augmentation_a_batch_is_unchanged(samples: Samples) -> None:
    """A recipe without augmentation returns the same batch and draws no random numbers."""
    rng = np.random.default_rng(5)

    assert augmented(samples, symmetries=False, no_contact=0.0, rng=rng) is samples
    assert rng.bit_generator.state == np.random.default_rng(5).bit_generator.state


def test_augmentation_depends_on_the_generator_alone(samples: Samples) -> None:
    """The same seed gives the same augmented batch, and another seed gives another."""
    batch = samples.select(torch.arange(32) % len(OBJECTS))
    first, second, other = (augmented(batch, True, 0.1, np.random.default_rng(seed)) for seed in (6, 6, 7))

    assert torch.equal(first.inputs, second.inputs)
    assert torch.equal(first.context, second.context)
    assert not torch.equal(first.context, other.context)


def test_all_eight_symmetries_are_drawn(samples: Samples) -> None:
    """An object without symmetry of its own appears under its eight indicators, about equally often."""
    batch = samples.select(torch.zeros(800, dtype=torch.long))
    found = augmented(batch, symmetries=True, no_contact=0.0, rng=np.random.default_rng(8))
    _, counts = torch.unique(found.context, dim=0, return_counts=True)

    assert len(counts) == 8
    assert counts.min() > 60


def test_empty_contexts_stay_empty(scenes: Pushes) -> None:
    """Samples without context are augmented by symmetric scenes too, and their contexts stay empty."""
    samples = Samples.of(scenes, ContextKind.NONE)
    found = with_symmetry(samples, 1, 0)

    assert found.context.shape == (len(OBJECTS), 0)
    assert not torch.equal(found.inputs, samples.inputs)
    assert replace(found, inputs=samples.inputs, targets=samples.targets).shape == samples.shape


def test_an_object_is_seen_by_one_of_its_views_or_as_drawn(scenes: Pushes) -> None:
    """A quarter of the objects appear as drawn, the others as one of their camera views, all as likely."""
    cameras = np.stack([np.full((len(OBJECTS), 1, 32, 32), level, dtype=np.uint8) for level in (51, 102, 153)], axis=1)
    samples = Samples.of(scenes.with_camera_views(cameras), ContextKind.VISUAL)
    many = samples.select(torch.arange(1200) % len(OBJECTS))
    found = augmented(many, symmetries=False, no_contact=0.0, rng=np.random.default_rng(4))

    level = found.context[:, 0, 0, 0]
    assert [float((level == share).float().mean()) for share in (0.2, 0.4, 0.6)] == pytest.approx([0.25] * 3, abs=0.04)
    assert torch.equal(found.context[level == 0.0], many.context[level == 0.0])
