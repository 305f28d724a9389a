"""The environment for gymnasium: its own checker, the reward, the ends of an episode, and the options."""

import math
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.errors import InvalidRequestError

gymnasium = pytest.importorskip("gymnasium", reason="the environment needs the extra gym")

from gymnasium.utils.env_checker import check_env  # noqa: E402 - after the skip

from training.environments.environment import (  # noqa: E402
    PUSHES_AROUND,
    WORLD_PUSHES,
    PushToGoal,
    PushToGoalAround,
    register,
    to_action,
)

BOX = [(-0.05, -0.03), (0.05, -0.03), (0.05, 0.03), (-0.05, 0.03)]
BESIDE = {"outline": BOX, "start": (0.0, 0.0, 0.0), "goal": (0.03, 0.0, 0.0)}
AWAY = (0.5, 0.5, 0.0, 0.05)  # a push that touches nothing


@pytest.mark.parametrize("name", [WORLD_PUSHES, PUSHES_AROUND])
def test_gymnasiums_checker_finds_no_fault(name: str) -> None:
    """The checker passes without a warning, rendering included."""
    register()
    environment = gymnasium.make(name, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment.unwrapped)
    environment.close()


def test_importing_registers_nothing_and_needs_no_torch(project_root: Path) -> None:
    """A fresh interpreter has neither the names nor torch, pyarrow or matplotlib after the import."""
    code = (
        "import sys, training.environments.environment, gymnasium;"
        "print([name for name in gymnasium.registry if name.startswith('cazsl')],"
        "sorted({'torch', 'pyarrow', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] []"


def test_an_episode_ends_at_the_goal() -> None:
    """A push through the middle brings the box to a goal 30 mm ahead. The reward is minus the distance that is left."""
    environment = PushToGoal()
    observation, info = environment.reset(seed=1, options=BESIDE)
    assert observation["pose"].tolist() == [0.0, 0.0, 0.0]
    assert observation["goal"].tolist() == [0.03, 0.0, 0.0]
    assert info["position_error_m"] == pytest.approx(0.03)

    observation, reward, reached, cut_off, info = environment.step(to_action((-0.07, 0.0, 0.0, 0.043)))
    assert (reached, cut_off) == (True, False)
    assert info["position_error_m"] == pytest.approx(math.hypot(*(observation["pose"] - observation["goal"])[:2]))
    size_m = environment.table.outline.size_m
    assert reward == pytest.approx(-(info["position_error_m"] + size_m * abs(observation["pose"][2])))
    assert -0.01 < reward < 0.0


def test_a_turn_alone_is_not_reached() -> None:
    """At the place of the goal, a box that should be turned by 20 degrees is away by its size times the turn."""
    environment = PushToGoal()
    environment.reset(seed=1, options={**BESIDE, "goal": (0.0, 0.0, math.radians(20.0))})
    _, reward, reached, _, info = environment.step(to_action(AWAY))
    assert not reached
    assert info["angle_error_rad"] == pytest.approx(math.radians(20.0))
    assert reward == pytest.approx(-environment.table.outline.size_m * math.radians(20.0))


def test_an_episode_is_cut_off_after_its_pushes() -> None:
    """The third of three pushes is the last."""
    environment = PushToGoal(most_pushes=3)
    environment.reset(seed=1, options=BESIDE)
    assert [environment.step(to_action(AWAY))[3] for _ in range(3)] == [False, False, True]


def test_a_push_from_inside_is_not_made_and_says_why() -> None:
    """The object stays, the push counts, and the next episode begins without it."""
    environment = PushToGoal(most_pushes=1)
    environment.reset(seed=1, options=BESIDE)
    observation, _, _, cut_off, info = environment.step(to_action((0.0, 0.0, 0.0, 0.1)))
    assert "inside of the object" in info["refused"]
    assert cut_off
    assert (observation["pose"] == 0.0).all()

    environment.reset(seed=1, options=BESIDE)
    assert "refused" not in environment.step(to_action(AWAY))[4]


def test_actions_around_the_object_touch_it() -> None:
    """The numbers 0 push the box along its x axis through its middle."""
    environment = PushToGoalAround()
    environment.reset(seed=1, options={**BESIDE, "friction": 0.2})
    observation, *_, info = environment.step(np.zeros(3))
    assert info["push"][2:] == pytest.approx([0.0, 0.055])
    assert observation["pose"][0] == pytest.approx(0.05, abs=0.005)


def test_a_seed_decides_the_episode() -> None:
    """The same seed draws the same object, goal and outcomes, and another seed or the next episode others."""
    environment = PushToGoalAround()

    def episode(seed: int | None) -> np.ndarray[Any, np.dtype[np.float64]]:
        observation, _ = environment.reset(seed=seed)
        after = environment.step(np.array([0.3, 0.2, 0.5]))[0]
        return np.concatenate([observation["outline"].ravel(), observation["goal"], after["pose"]])

    first, following = episode(3), episode(None)
    assert (episode(3) == first).all()
    assert (following != first).any()
    assert (episode(4) != first).any()


@pytest.mark.parametrize("given", [{"start": (0.2, 0.3, 1.0)}, {"goal": (0.2, 0.3, 1.0)}])
def test_the_other_pose_is_drawn_near_a_given_one(given: dict[str, Any]) -> None:
    """Start and goal are 50 to 200 mm apart if one of them is given."""
    environment = PushToGoal()
    observation, _ = environment.reset(seed=5, options=given)
    name = "pose" if "start" in given else "goal"
    assert observation[name] == pytest.approx([0.2, 0.3, 1.0])
    assert 0.05 <= math.dist(observation["pose"][:2], observation["goal"][:2]) <= 0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": BOX}, "options: received shape; accepted is any of outline"),
        ({"outline": [(0, 0), (1, 1)]}, r"options\.outline: received 2 corners"),
        ({"outline": [(0, 0), (1.5, 0), (0, 1)]}, r"options\.outline: received a corner 1\.5 m"),
        ({"start": (0, 0)}, r"options\.start"),
        ({"goal": (0, math.nan, 0)}, r"options\.goal"),
        ({"goal": (0, 2, 0)}, "within 1 m of the origin"),
        ({"outline": BOX, "centre_of_mass": (0.2, 0.0)}, r"options\.centre_of_mass"),
        ({"friction": -0.1}, r"options\.friction"),
        ({"pusher_radius": math.inf}, r"options\.pusher_radius"),
    ],
)
def test_options_that_are_none_are_refused(options: dict[str, Any], message: str) -> None:
    """The error names the option, its value, and the values that are accepted."""
    with pytest.raises(InvalidRequestError, match=message):
        PushToGoal().reset(seed=1, options=options)


def test_a_render_mode_that_is_none_is_refused() -> None:
    """There is no window."""
    with pytest.raises(ValueError, match="'human' is not known"):
        PushToGoal(render_mode="human")


def test_an_action_that_is_none_is_refused() -> None:
    """Numbers that are not finite, too few numbers and negative lengths are errors."""
    environment = PushToGoal()
    environment.reset(seed=1, options=BESIDE)
    for action in ([0.5, 0.5, math.nan, 0.0], [0.5, 0.5, 0.0], [0.5, 0.5, 0.0, -1.5]):
        with pytest.raises(InvalidRequestError):
            environment.step(np.array(action))
    around = PushToGoalAround()
    around.reset(seed=1, options=BESIDE)
    for numbers in ([0.5, 0.5, math.inf], [0.5, 0.5, 0.0, 0.0]):
        with pytest.raises(InvalidRequestError, match="action"):
            around.step(np.array(numbers))


def test_a_picture_is_drawn_on_demand() -> None:
    """A picture changes with a push, and without a render mode there is none."""
    environment = PushToGoal(render_mode="rgb_array")
    environment.reset(seed=1, options=BESIDE)
    before = environment.render()
    environment.step(to_action((-0.07, 0.0, 0.0, 0.043)))
    after = environment.render()
    assert before is not None
    assert after is not None
    assert before.dtype == np.uint8
    assert (before != after).any()
    assert PushToGoal().render() is None
