"""Tasks for planners, drawn."""

import math

import numpy as np

from training.environments.tasks import draw_tasks


def test_tasks_are_drawn_within_their_ranges_from_families_in_turn() -> None:
    """Objects are 50 to 200 mm across, goals are 50 to 200 mm away and turned by at most 90 degrees."""
    tasks = draw_tasks(("T", "bean"), 6, seed=4)

    assert [task.drawn.family for task in tasks] == ["T", "bean"] * 3
    for task in tasks:
        assert 0.05 <= task.drawn.outline.extent_m <= 0.2
        assert 0.05 <= math.dist(task.start[:2], task.goal[:2]) <= 0.2
        assert abs(task.goal[2] - task.start[2]) <= math.pi / 2
        assert (task.tabletop().pose == task.start).all()


def test_a_task_depends_on_its_number_and_the_seed_alone() -> None:
    """More tasks or another call change no task, and another seed changes all."""
    few, many, other = draw_tasks(("T",), 2, seed=1), draw_tasks(("T",), 3, seed=1), draw_tasks(("T",), 2, seed=2)

    for one, same, different in zip(few, many, other, strict=False):
        assert (one.drawn.outline.corners == same.drawn.outline.corners).all()
        assert (one.goal == same.goal).all()
        assert one.seed == same.seed
        assert one.seed != different.seed
    push = np.array([*(few[0].start[:2] - (0.15, 0.0)), 0.0, 0.2])
    assert (few[0].tabletop().push(push) == many[0].tabletop().push(push)).all()
    assert (few[0].tabletop().push(push) != few[0].start).any()
