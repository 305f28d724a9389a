"""Client for asyncio."""

import asyncio
import math
import os
from collections.abc import Sequence
from types import TracebackType
from typing import Self, TypeVar, Unpack

import httpx2
import numpy.typing as npt

from service.client import calls, plan_calls, planning_calls
from service.client.arguments import Context, Details, Image, ScaledDetails
from service.client.base import DEFAULT_URL, IN_PROCESS_URL, ONE_ATTEMPT, ClientBase, add_part
from service.client.calls import Call, Predictions
from service.client.connections import UNREACHABLE, Connections, connect_from_environment
from service.client.deadline import ConnectionWatch, Deadline
from service.client.plan_calls import Plan, Refinement
from service.client.planning_calls import PushMap, Region, Rollout
from service.client.retries import Retries, retry_after_s
from service.schemas.image_contexts import OutlineContextBody, VisualContextBody
from service.schemas.models import ModelBody, ModelsBody, ModelVersionDetailBody
from service.schemas.predictions import PredictResponse

T = TypeVar("T")


class AsyncClient(ClientBase):
    """A client for asyncio, with the methods of ``Client`` as coroutines. One client serves any number of tasks."""

    def __init__(
        self,
        url: str = DEFAULT_URL,
        *,
        key: str | None = None,
        timeout_s: float = 10.0,
        retries: Retries | None = None,
        http: httpx2.AsyncClient | None = None,
    ) -> None:
        super().__init__(url, key, timeout_s, retries)
        self._connections = Connections(
            http,
            lambda: connect_from_environment(url, httpx2.AsyncClient, httpx2.AsyncHTTPTransport),
            lambda: (os.getpid(), asyncio.get_running_loop()),
        )

    @classmethod
    def local(cls, registry: str = "models", *, require_signature: str = "") -> Self:
        """See ``Client.local``. Predictions run in threads."""
        from service.client.local import InProcess  # as in Client

        http = httpx2.AsyncClient(transport=InProcess.over(registry, require_signature))
        return cls(IN_PROCESS_URL, timeout_s=math.inf, retries=ONE_ATTEMPT, http=http)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close all connections."""
        await self._connections.http.aclose()

    async def predict(
        self,
        pusher: npt.ArrayLike,
        context: Context | None = None,
        *,
        length: float | None = None,
        model: str | None = None,
        object_pose: npt.ArrayLike | None = None,
    ) -> PredictResponse:
        """See ``Client.predict``."""
        return await self._send(calls.predict(pusher, context, model, object_pose, length))

    async def predict_batch(
        self,
        pushers: npt.ArrayLike,
        contexts: Context | Sequence[Context] | None = None,
        context_index: npt.ArrayLike | None = None,
        *,
        lengths: npt.ArrayLike | None = None,
        model: str | None = None,
        object_poses: npt.ArrayLike | None = None,
    ) -> Predictions:
        """See ``Client.predict_batch``."""
        return await self._send(calls.predict_batch(pushers, contexts, context_index, model, object_poses, lengths))

    async def predict_image(
        self,
        image: Image,
        pushers: npt.ArrayLike,
        *,
        lengths: npt.ArrayLike | None = None,
        model: str | None = None,
        object_poses: npt.ArrayLike | None = None,
        **details: Unpack[Details],
    ) -> Predictions:
        """See ``Client.predict_image``."""
        return await self._send(calls.predict_image(image, pushers, model, object_poses, lengths, details))

    async def make_context(self, image: Image) -> VisualContextBody:
        """See ``Client.make_context``."""
        return await self._send(calls.make_context(image))

    async def find_outline(self, image: Image, **details: Unpack[ScaledDetails]) -> OutlineContextBody:
        """See ``Client.find_outline``."""
        return await self._send(calls.find_outline(image, details))

    async def rollout(
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
        """See ``Client.rollout``."""
        return await self._send(
            planning_calls.rollout(pushes, context, object_pose, region, particles, seed, model, return_particles)
        )

    async def rollouts(
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
        """See ``Client.rollouts``."""
        return await self._send(
            planning_calls.rollouts(sequences, context, object_pose, region, particles, seed, model)
        )

    async def push_map(
        self,
        context: Context,
        *,
        spacing: float | None = None,
        angles: npt.ArrayLike | None = None,
        length: float | None = None,
        model: str | None = None,
    ) -> PushMap:
        """See ``Client.push_map``."""
        return await self._send(planning_calls.push_map(context, spacing, angles, length, model))

    async def plan(
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
        """See ``Client.plan``."""
        return await self._send(
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

    async def refine(
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
        """See ``Client.refine``."""
        return await self._send(plan_calls.refine(context, pushers, outcomes, lengths, object_poses, seed, model))

    async def list_models(self) -> ModelsBody:
        """See ``Client.list_models``."""
        return await self._send(calls.list_models())

    async def show_model(self, name: str) -> ModelBody:
        """See ``Client.show_model``."""
        return await self._send(calls.show_model(name))

    async def show_version(self, name: str, version: int) -> ModelVersionDetailBody:
        """See ``Client.show_version``."""
        return await self._send(calls.show_version(name, version))

    async def _send(self, call: Call[T]) -> T:
        deadline = Deadline(self._timeout_s)
        attempt = 0
        while True:
            attempt += 1
            response, content = await self._exchange(call, deadline)
            pause_s = self._pause_s(attempt, response, deadline)
            if pause_s is None:
                return call.read(response.status_code, content, retry_after_s(response.headers.get("retry-after")))
            await asyncio.sleep(pause_s)

    async def _exchange(self, call: Call[T], deadline: Deadline) -> tuple[httpx2.Response, bytes]:
        """Send one request and read the whole answer before the deadline. See ``Client``."""
        while True:
            content, http = bytearray(), self._connections.in_use()
            watch = ConnectionWatch(deadline)
            try:
                async with (
                    asyncio.timeout(deadline.bound_s(None)),
                    http.stream(**self._request(call, deadline, watch.trace_async)) as response,
                ):
                    async for part in response.aiter_raw():
                        add_part(content, part, call.max_answer_bytes)
                        deadline.bound_s(None)
                return response, bytes(content)
            except (TimeoutError, httpx2.TimeoutException) as error:
                raise self._timed_out() from error
            except UNREACHABLE as error:
                if not watch.was_idle:
                    raise self._unreachable(error) from error
