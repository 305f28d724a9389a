"""Gymnasium environment: push an object on a table to a goal pose, in MuJoCo.

    import gymnasium
    from training.environments.environment import register

    register()
    env = gymnasium.make("cazsl/PushToGoal-v0", render_mode="rgb_array")
    observation, info = env.reset(seed=1, options={"outline": [[0, 0], [0.1, 0], [0, 0.06]], "goal": [0.2, 0.1, 0.5]})
    observation, reward, reached, cut_off, info = env.step(to_action([-0.03, 0.02, 0.0, 0.1]))
    picture = env.render()

An action is a push in the world, in numbers from -1 to 1 as gymnasium recommends. ``to_action`` makes it of the push of
a planner, ``x_m, y_m, angle_rad, length_m``. Learners rather take
``cazsl/PushToGoalAround-v0``, whose actions are three numbers from -1 to 1 and always touch the object (``around``).

The reward is minus the distance to the goal after the push, in metres: that of the positions, and the turn times the
object's size (the root mean square distance of its area from its centroid), which is how far its points are from
where they should be. An episode ends within 10 mm and 10 degrees of the goal, and is cut off after 10 pushes.
"""

import math
from dataclasses import replace
from typing import Any, Final, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from service.errors import InvalidRequestError
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angle
from service.pushing.shape_context import CORNERS, reduced
from training.environments.around import push_around
from training.environments.pictures import View, draw_table
from training.environments.tasks import draw_pose, draw_task
from training.shapes.families import FAMILIES
from training.shapes.objects import DrawnObject
from training.simulation.bodies import ANY_PLATE
from training.simulation.scene import PUSHER_RADIUS_M

WORLD_PUSHES: Final = "cazsl/PushToGoal-v0"
PUSHES_AROUND: Final = "cazsl/PushToGoalAround-v0"
MOST_PUSHES: Final = 10
LONGEST_PUSH_M: Final = 0.2
TABLE_M: Final = 1.0  # of given poses, corners and starts of pushes from the origin, along each axis
REACH_M: Final = 10.0  # of an object that was pushed
OPTIONS: Final = ("outline", "start", "goal", "centre_of_mass", "friction", "pusher_radius")

_MIDDLE: Final = np.array([0.0, 0.0, 0.0, LONGEST_PUSH_M / 2.0])  # the push of which all numbers are 0
_SCALE: Final = np.array([TABLE_M, TABLE_M, np.pi, LONGEST_PUSH_M / 2.0])

Observation = dict[str, DoubleArray]


class PushToGoal(gymnasium.Env[Observation, DoubleArray]):
    """Push an object to a goal pose, by pushes in the world.

    Observation, in metres and radians:

    - ``pose`` and ``goal``: (3,) x, y, yaw of the object in the world.
    - ``outline``: (64, 2) corners in the object frame, the last one repeated to fill it.

    Action: (4,) from -1 to 1, see ``to_action``. A push that starts inside of the object is not made, and
    ``info["refused"]`` has the reason. It counts as a push.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012 - gymnasium's own declaration

    def __init__(
        self,
        families: tuple[str, ...] = tuple(FAMILIES),
        most_pushes: int = MOST_PUSHES,
        position_tolerance_m: float = 0.01,
        angle_tolerance_rad: float = math.radians(10.0),
        render_mode: str | None = None,
    ) -> None:
        """Create the environment.

        Args:
            families: of the objects that are drawn, see ``training.shapes.families``.
            most_pushes: of an episode.
            position_tolerance_m: from the goal.
            angle_tolerance_rad: from the goal.
            render_mode: ``rgb_array`` or None.

        Raises:
            ValueError: the render mode is not known.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r} is not known; use 'rgb_array', or None")
        self.render_mode = render_mode
        self._families = families
        self._most_pushes = most_pushes
        self._tolerances = position_tolerance_m, angle_tolerance_rad
        pose = spaces.Box(np.array([-REACH_M, -REACH_M, -np.pi]), np.array([REACH_M, REACH_M, np.pi]), dtype=np.float64)
        outline = spaces.Box(-TABLE_M, TABLE_M, (CORNERS, 2), np.float64)
        self.observation_space = cast(
            "spaces.Space[Observation]", spaces.Dict({"pose": pose, "goal": pose, "outline": outline})
        )
        self.action_space: spaces.Space[DoubleArray] = spaces.Box(-1.0, 1.0, (4,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode with an object that is drawn, or given by the options.

        Args:
            seed: of this episode and those after it.
            options: any of ``outline`` (corners (n, 2) m), ``start`` and ``goal`` (x, y, yaw in the world),
                ``centre_of_mass`` (x, y in the frame of the outline), ``friction`` and ``pusher_radius``. With an
                outline, the others are by default the centroid and usual values.

        Raises:
            InvalidRequestError: an option is not known, or its value is none.
        """
        super().reset(seed=seed)
        given = options or {}
        if unknown := sorted(set(given) - set(OPTIONS)):
            raise InvalidRequestError.at("options", ", ".join(unknown), f"any of {', '.join(OPTIONS)}")
        task = draw_task(self._families[self.np_random.integers(len(self._families))], self.np_random)
        start, goal = (_pose(given[name], f"options.{name}") if name in given else None for name in ("start", "goal"))
        if start is None:
            start = task.start if goal is None else draw_pose(goal, self.np_random)
        if goal is None:
            goal = draw_pose(start, self.np_random)
        try:
            self.table = replace(task, drawn=_with_options(task.drawn, given), start=start).tabletop()
        except ValueError as error:
            where = "options.centre_of_mass"
            raise InvalidRequestError.at(where, f"a place where {error}", "a place inside of the outline") from error
        self.goal = np.array([*goal[:2], wrap_angle(float(goal[2]))])
        self._view = View.of(self.table.outline, self.table.pose, self.goal)
        self._pushes: list[DoubleArray] = []
        return self._observation(), self._info()

    def step(self, action: DoubleArray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Make a push.

        Returns:
            The observation after it, the reward, true within the tolerances, true after the last push, and ``info``:
            ``push`` in the world, ``position_error_m``, ``angle_error_rad``, and ``refused`` if it was not made.

        Raises:
            InvalidRequestError: the action is not finite numbers of the right count, or its length is negative.
        """
        push = self._push(action)
        info: dict[str, Any] = {"push": push}
        if self.table.depth_m(push) > 0.0:
            info["refused"] = "the push starts inside of the object; start it outside of the outline"
        else:
            self.table.push(push)
        self._pushes.append(push)
        info |= self._info()
        position_m, angle_rad = info["position_error_m"], info["angle_error_rad"]
        reward = -(position_m + self.table.outline.size_m * angle_rad)
        reached = position_m <= self._tolerances[0] and angle_rad <= self._tolerances[1]
        return self._observation(), reward, reached, len(self._pushes) >= self._most_pushes and not reached, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Draw the table from above, (400, 400, 3): the object, the goal, and the last push with its tip at the end."""
        if self.render_mode is None:
            return None
        last = self._pushes[-1] if self._pushes else None
        return draw_table(self._view, self.table.outline, self.table.pose, self.goal, last, self.table.pusher_radius_m)

    def _push(self, action: DoubleArray) -> DoubleArray:
        """Return the push (4,) in the world of an action."""
        return np.asarray(_MIDDLE + _numbers(action, "action", 4) * _SCALE)

    def _observation(self) -> Observation:
        outline = np.empty((CORNERS, 2))
        corners = reduced(self.table.outline.corners, CORNERS)
        outline[: len(corners)], outline[len(corners) :] = corners, corners[-1]
        return {"pose": self.table.pose, "goal": self.goal.copy(), "outline": outline}

    def _info(self) -> dict[str, Any]:
        x, y, yaw = self.table.pose - self.goal
        return {"position_error_m": math.hypot(x, y), "angle_error_rad": abs(wrap_angle(float(yaw)))}


class PushToGoalAround(PushToGoal):
    """The same with actions for learners: three numbers (3,) from -1 to 1 that name a push about the object.

    They are its heading in the object frame, the place of its line across the object, and its travel after the first
    contact, see ``around.push_around``.
    """

    def __init__(self, **options: Any) -> None:
        """Create the environment. The options are those of ``PushToGoal``."""
        super().__init__(**options)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float64)

    def _push(self, action: DoubleArray) -> DoubleArray:
        numbers = _numbers(action, "action", 3)
        return push_around(self.table.outline, self.table.pose, self.table.pusher_radius_m, numbers)


def to_action(push: npt.ArrayLike) -> DoubleArray:
    """Return the action (4,) of a push (4,) in the world: x_m, y_m, angle_rad, length_m.

    These are x and y in metres, the angle over pi, and the length, of which -1 is 0 and 1 is 0.2 m.
    """
    x, y, angle, length = np.asarray(push, dtype=np.float64)
    action: DoubleArray = (np.array([x, y, wrap_angle(float(angle)), length]) - _MIDDLE) / _SCALE
    return action


def register() -> None:
    """Make both environments known to ``gymnasium.make``. Another call changes nothing."""
    for name, kind in ((WORLD_PUSHES, PushToGoal), (PUSHES_AROUND, PushToGoalAround)):
        if name not in gymnasium.registry:
            gymnasium.register(name, f"{kind.__module__}:{kind.__name__}")


def _pose(values: npt.ArrayLike, where: str) -> DoubleArray:
    found = _numbers(values, where, 3)
    if not (np.abs(found[:2]) <= TABLE_M).all():
        accepted = f"x and y within {TABLE_M:g} m of the origin"
        raise InvalidRequestError.at(where, f"({found[0]:.3g}, {found[1]:.3g}) m", accepted)
    return found


def _numbers(values: npt.ArrayLike, where: str, count: int) -> DoubleArray:
    found = np.asarray(values, dtype=np.float64)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise InvalidRequestError.at(where, f"{values!r:.100}", f"finite numbers, {count} in all")
    return found


def _with_options(drawn: DrawnObject, given: dict[str, Any]) -> DrawnObject:
    """Return an object with those of its properties that options give."""
    if "outline" in given:
        outline = _outline(given["outline"])
        x, y = outline.centroid_m.tolist()
        drawn = DrawnObject("given", outline, (x, y), drawn.mass_kg, ANY_PLATE.contact, PUSHER_RADIUS_M)
    if "centre_of_mass" in given:
        x, y = _numbers(given["centre_of_mass"], "options.centre_of_mass", 2).tolist()
        drawn = replace(drawn, centre_of_mass_m=(x, y))
    friction = _positive(given, "friction", drawn.friction, 2.0)
    return replace(
        drawn, friction=friction, pusher_radius_m=_positive(given, "pusher_radius", drawn.pusher_radius_m, 0.1)
    )


def _positive(given: dict[str, Any], option: str, default: float, most: float) -> float:
    where = f"options.{option}"
    value = float(_numbers([given.get(option, default)], where, 1)[0])
    if not 0.0 < value <= most:
        raise InvalidRequestError.at(where, f"{value:g}", f"over 0, and at most {most:g}")
    return value


def _outline(corners: npt.ArrayLike) -> Outline:
    found = Outline.of(corners, "options.outline")
    if np.abs(found.corners).max() > TABLE_M:
        received = f"a corner {np.abs(found.corners).max():.3g} m from the origin"
        raise InvalidRequestError.at("options.outline", received, f"corners within {TABLE_M:g} m of it along each axis")
    return found
