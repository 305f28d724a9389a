"""Rollouts: clouds of particles after each push, with a model that is known in closed form."""

import math

import numpy as np
import pytest

from service.planning.push_model import PushOutcomes
from service.planning.rollout import rollout
from service.pushing.poses import DoubleArray

AHEAD = np.array([[[-0.1, 0.0, 0.0, 0.05], [-0.1, 0.0, 0.0, 0.05], [-0.1, 0.0, 0.0, 0.05]]])


class Slider:
    """Model of an object that moves along each push by a length, and never turns by itself."""

    def __init__(self, std: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self.std = np.array(std)
        self.rows: list[int] = []

    def __call__(self, pushes: DoubleArray) -> PushOutcomes:
        """Move along the push. Pushes that start on the right of the object miss it."""
        self.rows.append(len(pushes))
        x, angle, length = pushes[:, 0], pushes[:, 2], pushes[:, 3]
        mean = np.column_stack([length * np.cos(angle), length * np.sin(angle), np.zeros(len(pushes))])
        misses = x > 0.0
        mean[misses] = 0.0
        return PushOutcomes(
            mean, np.broadcast_to(self.std, mean.shape), misses, np.abs(pushes[:, 0]) < 0.01, pushes[:, 1] > 0.5
        )


def test_pushes_stay_in_the_world_while_the_object_turns() -> None:
    """A push along the world's x axis moves the object along it, whatever way the object looks."""
    found = rollout(Slider(), np.array([0.0, 0.0, math.pi / 3]), AHEAD[:, :1], 4)
    assert found.particles[0, 0] == pytest.approx(np.tile([0.05, 0.0, math.pi / 3], (4, 1)))


def test_spread_grows_as_variances_add() -> None:
    """After k independent pushes the variance is k times that of one."""
    std = (0.001, 0.002, 0.0)
    found = rollout(Slider(std), np.array([-0.05, 0.0, 0.0]), AHEAD[:, :2], 20_000, seed=3).moments()
    for step in (0, 1):
        assert np.sqrt(np.diagonal(found.covariance[0, step])) == pytest.approx(
            np.array(std) * math.sqrt(step + 1), rel=0.03, abs=1e-9
        )


def test_each_particle_meets_the_push_at_its_own_pose() -> None:
    """After a push of large spread some particles are where the next push misses them."""
    found = rollout(Slider((0.06, 0.0, 0.0)), np.array([-0.09, 0.0, 0.0]), AHEAD, 1000)
    assert found.miss_probability[0, 0] in (0.0, 1.0)
    assert 0.05 < found.miss_probability[0, 2] < 0.95


def test_the_first_push_is_predicted_once() -> None:
    """All particles start at one pose, so one row is enough, and later ones take a row each."""
    model = Slider()
    rollout(model, np.zeros(3), AHEAD, 8)
    assert model.rows == [1, 8, 8]


def test_particles_may_be_given_instead_of_one_pose() -> None:
    """A pose that is known by particles is pushed from each of them."""
    start = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    found = rollout(Slider(), start, AHEAD[:, :1], 3)
    assert found.particles[0, 0, :, 0] - start[:, 0] == pytest.approx([0.05, 0.05, 0.05])


def test_a_seed_gives_the_same_particles_and_sequences_share_them() -> None:
    """Answers repeat for a seed, differ for another, and equal sequences have equal clouds."""
    twice = np.repeat(AHEAD, 2, axis=0)
    first, again, other = (rollout(Slider((0.01, 0.01, 0.1)), np.zeros(3), twice, 16, seed) for seed in (0, 0, 1))
    assert np.array_equal(first.particles, again.particles)
    assert not np.array_equal(first.particles, other.particles)
    assert np.array_equal(first.particles[0], first.particles[1])


def test_pushes_outside_of_the_domain_are_counted() -> None:
    """The share of particles whose push the model does not vouch for is reported for each push."""
    found = rollout(Slider(), np.array([0.0, -0.6, 0.0]), AHEAD, 4)
    assert found.unfamiliar_probability.tolist() == [[1.0, 1.0, 1.0]]


def test_starts_inside_of_the_object_are_counted() -> None:
    """The share of particles that the tip starts inside of is reported for each push."""
    found = rollout(Slider(), np.array([-0.15, 0.0, 0.0]), AHEAD, 4)
    assert found.inside_probability.tolist() == [[0.0, 0.0, 0.0]]
    assert rollout(Slider(), np.array([-0.1, 0.0, 0.0]), AHEAD, 4).inside_probability.tolist() == [[1.0, 0.0, 0.0]]


def test_the_origin_of_the_frame_does_not_matter() -> None:
    """A spread about the object's centre gives the same clouds of it, wherever the origin of its frame is."""
    centre = np.array([3.0, -2.0])

    def far(pushes: DoubleArray) -> PushOutcomes:
        """Move and turn the centre of an object that is far from the origin of its frame."""
        count = len(pushes)
        no = np.zeros(count, dtype=np.bool_)
        turn = 0.3
        cos, sin = math.cos(turn), math.sin(turn)
        x, y = centre
        mean = np.array([x + 0.01 - (cos * x - sin * y), y - (sin * x + cos * y), turn])
        return PushOutcomes(np.tile(mean, (count, 1)), np.full((count, 3), 0.02), no, no, no, centre)

    found = rollout(far, np.zeros(3), AHEAD[:, :2], 5000, seed=1).particles[0, 0]
    cos, sin = np.cos(found[:, 2]), np.sin(found[:, 2])
    x, y = centre
    middle = np.stack([found[:, 0] + cos * x - sin * y, found[:, 1] + sin * x + cos * y], axis=1)
    assert middle.mean(axis=0) == pytest.approx(centre + np.array([0.01, 0.0]), abs=0.001)
    assert middle.std(axis=0) == pytest.approx([0.02, 0.02], rel=0.05)
    outcomes = far(np.zeros((1, 4)))
    assert found.std(axis=0) == pytest.approx(outcomes.frame_std()[0], rel=0.05)
