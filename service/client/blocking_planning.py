"""Methods of the blocking client about several pushes of one object."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TypeVar

import numpy.typing as npt

from service.client import plan_calls, planning_calls
from service.client.arguments import Context
from service.client.base import ClientBase
from service.client.calls import Call
from service.client.plan_calls import Plan, Refinement
from service.client.planning_calls import PushMap, Region, Rollout

T = TypeVar("T")


class BlockingPlanning(ClientBase):
    """The part of ``Client`` that asks about several pushes. Poses are in the world: x, y, angle in m, m, rad."""

    @abstractmethod
    def _send(self, call: Call[T]) -> T:
        """Send a request and return its answer."""
        ...

    def rollout(
        self,
        pushes: npt.ArrayLike,
        context: Context | None = None,
        *,
        object_pose: npt.ArrayLike = (0.0, 0.0, 0.0),
        region: Region | None = None,
        particles: int | None = None,
        seed: int = 0,
        model: str | None = None,
        return_particles: bool = False,
    ) -> Rollout:
        """Predict the object's pose after each of several pushes, in the world.

        Args:
            pushes: (k, 3) or (k, 4) x, y, angle, length of the pusher in the world, in m, m, rad, m.
            context: as in ``predict``.
            object_pose: (3,) pose of the object in the world before the first push.
            region: region for which the answer has the probability that the object ends in it.
            particles: poses that follow the pushes. None: 256.
            seed: of the random numbers.
            model: as in ``predict``.
            return_particles: whether the answer has the particles.
        """
        return self._send(
            planning_calls.rollout(pushes, context, object_pose, region, particles, seed, model, return_particles)
        )

    def rollouts(
        self,
        sequences: Sequence[npt.ArrayLike],
        context: Context | None = None,
        *,
        object_pose: npt.ArrayLike = (0.0, 0.0, 0.0),
        region: Region | None = None,
        particles: int | None = None,
        seed: int = 0,
        model: str | None = None,
    ) -> tuple[Rollout, ...]:
        """Predict candidate sequences of pushes, up to 10,000 pushes in all. See ``rollout``.

        Sequences share their random numbers, so they differ by their pushes alone.
        """
        return self._send(planning_calls.rollouts(sequences, context, object_pose, region, particles, seed, model))

    def push_map(
        self,
        context: Context,
        *,
        spacing: float | None = None,
        angles: npt.ArrayLike | None = None,
        length: float | None = None,
        model: str | None = None,
    ) -> PushMap:
        """Predict pushes from all around an object of known outline, in its frame.

        Args:
            context: an outline, the result of ``find_outline``, or a descriptor.
            spacing: distance between two places along the outline, in m. None: 48 places around it.
            angles: (a,) directions from the inward normal, in rad. None: -0.5, 0 and 0.5.
            length: of every push, in m. None: 0.05.
            model: as in ``predict``.
        """
        return self._send(planning_calls.push_map(context, spacing, angles, length, model))

    def plan(
        self,
        context: Context,
        object_pose: npt.ArrayLike,
        goal: npt.ArrayLike,
        *,
        position_tolerance: float = 0.01,
        angle_tolerance: float = 0.17,
        max_pushes: int = 10,
        lengths: npt.ArrayLike | None = None,
        workspace: npt.ArrayLike | None = None,
        obstacles: Sequence[npt.ArrayLike] = (),
        clearance: float | None = None,
        time_s: float | None = None,
        seed: int = 0,
        model: str | None = None,
    ) -> Plan:
        """Plan pushes that bring an object of known outline from a pose to a goal, in the world.

        Args:
            context: an outline, the result of ``find_outline``, or a descriptor.
            object_pose: (3,) pose of the object now.
            goal: (3,) pose to bring it to.
            position_tolerance: distance from the goal that is near enough, in m.
            angle_tolerance: turn from the goal that is small enough, in rad.
            max_pushes: most pushes of the plan, up to 20.
            lengths: that a push may have, in m. None: 0.02, 0.05 and 0.1, or 0.05 for models that know no other.
            workspace: (n, 2) corners of the polygon that object and tip stay in.
            obstacles: (n, 2) corners of each polygon that neither of them touches.
            clearance: that both keep, in m. None: 0.005.
            time_s: time budget of the search. None: 0.3.
            seed: of the random numbers of the probabilities.
            model: as in ``predict``.
        """
        return self._send(
            plan_calls.plan(
                context,
                object_pose,
                goal,
                position_tolerance,
                angle_tolerance,
                max_pushes,
                lengths,
                workspace,
                obstacles,
                clearance,
                time_s,
                seed,
                model,
            )
        )

    def refine(
        self,
        context: Context,
        pushers: npt.ArrayLike,
        outcomes: npt.ArrayLike,
        *,
        lengths: npt.ArrayLike | None = None,
        object_poses: npt.ArrayLike | None = None,
        seed: int = 0,
        model: str | None = None,
    ) -> Refinement:
        """Learn from 1 to 50 pushes of an object where its weight is, and return its context with that.

        Args:
            context: an object of any shape, as in ``predict``, or the ``context`` of an earlier answer.
            pushers: (n, 3) x, y, angle of the pusher in m, m, rad, in the object's frame before that push.
            outcomes: (n, 3) x, y, angle of the object after each push, in that frame.
            lengths: length of every push, or (n,), in m. None: 0.05.
            object_poses: (n, 3) poses of the object in the world before each push. Pushers and outcomes are then in
                the world.
            seed: of the random numbers.
            model: as in ``predict``.
        """
        return self._send(plan_calls.refine(context, pushers, outcomes, lengths, object_poses, seed, model))
