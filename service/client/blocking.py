"""Blocking client."""

import math
import os
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Self, TypeVar, Unpack

import httpx2
import numpy.typing as npt

from service.client import calls
from service.client.arguments import Context, Details, Image, ScaledDetails
from service.client.base import DEFAULT_URL, IN_PROCESS_URL, ONE_ATTEMPT, add_part
from service.client.blocking_planning import BlockingPlanning
from service.client.calls import Call, Predictions
from service.client.connections import UNREACHABLE, Connections, connect_from_environment
from service.client.deadline import ConnectionWatch, Deadline
from service.client.retries import Retries, retry_after_s
from service.schemas.image_contexts import OutlineContextBody, VisualContextBody
from service.schemas.models import ModelBody, ModelsBody, ModelVersionDetailBody
from service.schemas.predictions import PredictResponse

T = TypeVar("T")


class Client(BlockingPlanning):
    """A blocking client. Threads may share it, and a forked process. Connections stay open until it is closed.

    Args:
        url: address of the service.
        key: API key, if the service requires one.
        timeout_s: limit of a call, in s: connect, send, read the whole answer, and all retries with their pauses. inf
            is none.
        retries: number and pauses of retries after a 503. No other answer is retried.
        http: your own httpx client, for TLS, proxies or other transports. It is closed with this client.

    Raises:
        ClientSetupError: the address, the key, or a proxy or certificate of the environment, cannot be used.

    Every method raises:
        ProblemError: the service refused the request. ``code``, ``detail`` and ``faults`` give the reason.
        UnreachableError: there was no answer. Its subclass TimedOutError: there was none in time.
        UnreadableAnswerError: the answer is not that of a CAZSL service.
    """

    def __init__(
        self,
        url: str = DEFAULT_URL,
        *,
        key: str | None = None,
        timeout_s: float = 10.0,
        retries: Retries | None = None,
        http: httpx2.Client | None = None,
    ) -> None:
        super().__init__(url, key, timeout_s, retries)
        self._connections = Connections(
            http, lambda: connect_from_environment(url, httpx2.Client, httpx2.HTTPTransport), os.getpid
        )

    @classmethod
    def local(cls, registry: str = "models", *, require_signature: str = "") -> Self:
        """Create a client that predicts in this process, with the present models of a registry.

        Args:
            registry: a folder of models, or s3://bucket/prefix.
            require_signature: public keys (PEM files, separated as in PATH). One of them must have signed a version.

        Raises:
            RegistryError: the registry or a key cannot be read.
            ModelNotReadyError: no model of the registry can be loaded.
        """
        from service.client.local import InProcess  # loads onnxruntime, which a client of a service does not need

        http = httpx2.Client(transport=InProcess.over(registry, require_signature))
        return cls(IN_PROCESS_URL, timeout_s=math.inf, retries=ONE_ATTEMPT, http=http)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close all connections."""
        self._connections.http.close()

    def predict(
        self,
        pusher: npt.ArrayLike,
        context: Context | None = None,
        *,
        length: float | None = None,
        model: str | None = None,
        object_pose: npt.ArrayLike | None = None,
    ) -> PredictResponse:
        """Predict the object's pose after one push, with its uncertainty.

        Args:
            pusher: (3,) x and y of the pusher's tip in m, direction of the push in rad, in the object's frame. With
                ``object_pose`` it is in the world frame.
            context: the object: a descriptor such as ``1a2b3c4a``, a ``ContextBody``, or the result of
                ``make_context`` or ``find_outline``. None for models without context.
            length: length of the push in m. None: 0.05, the only one that models of other contexts than outlines know.
            model: name, name@alias or name@version. None selects the champion for this kind of context.
            object_pose: (3,) pose of the object in the world frame. The answer is then in the world frame, with its
                covariance.
        """
        return self._send(calls.predict(pusher, context, model, object_pose, length))

    def predict_batch(
        self,
        pushers: npt.ArrayLike,
        contexts: Context | Sequence[Context] | None = None,
        context_index: npt.ArrayLike | None = None,
        *,
        lengths: npt.ArrayLike | None = None,
        model: str | None = None,
        object_poses: npt.ArrayLike | None = None,
    ) -> Predictions:
        """Predict up to 10,000 pushes.

        Args:
            pushers: (n, 3) as in ``predict``.
            contexts: one object for all pushes, one per push, or several with an index per push.
            context_index: (n,) index of each push's object in ``contexts``, from 0.
            lengths: length of every push, or (n,), in m, as in ``predict``.
            model: as in ``predict``.
            object_poses: (1, 3) or (n, 3) poses of the objects in the world frame, as in ``predict``.
        """
        return self._send(calls.predict_batch(pushers, contexts, context_index, model, object_poses, lengths))

    def predict_image(
        self,
        image: Image,
        pushers: npt.ArrayLike,
        *,
        lengths: npt.ArrayLike | None = None,
        model: str | None = None,
        object_poses: npt.ArrayLike | None = None,
        **details: Unpack[Details],
    ) -> Predictions:
        """Predict pushes (n, 3) of the object in an image, given as a path or as the content of a file.

        For several calls with one image, convert it once with ``make_context`` or ``find_outline``. With
        ``metres_per_pixel``, the scale of the image, its object is one of any shape, and the object frame is that of
        the image: the origin in its middle, x to the right and y up. See ``find_outline`` for the other details.
        """
        return self._send(calls.predict_image(image, pushers, model, object_poses, lengths, details))

    def make_context(self, image: Image) -> VisualContextBody:
        """Convert an image to the visual context that a model receives, for predictions and for inspection."""
        return self._send(calls.make_context(image))

    def find_outline(self, image: Image, **details: Unpack[ScaledDetails]) -> OutlineContextBody:
        """Find the outline of the object in an image whose scale is known, for predictions and to draw it.

        Args:
            image: a mask or a photograph from above, as in ``predict_image``.
            details: ``metres_per_pixel``, the scale, and if known ``centre_of_mass``, ``friction``,
                ``pusher_radius`` and ``pressure``, which go into the context. See ``ContextBody``.
        """
        return self._send(calls.find_outline(image, details))

    def list_models(self) -> ModelsBody:
        """List all served models with their versions and aliases."""
        return self._send(calls.list_models())

    def show_model(self, name: str) -> ModelBody:
        """Return one model with its versions and aliases."""
        return self._send(calls.show_model(name))

    def show_version(self, name: str, version: int) -> ModelVersionDetailBody:
        """Return one version with its manifest and its card."""
        return self._send(calls.show_version(name, version))

    def _send(self, call: Call[T]) -> T:
        deadline = Deadline(self._timeout_s)
        attempt = 0
        while True:
            attempt += 1
            response, content = self._exchange(call, deadline)
            pause_s = self._pause_s(attempt, response, deadline)
            if pause_s is None:
                return call.read(response.status_code, content, retry_after_s(response.headers.get("retry-after")))
            time.sleep(pause_s)

    def _exchange(self, call: Call[T], deadline: Deadline) -> tuple[httpx2.Response, bytes]:
        """Send one request and read the whole answer before the deadline.

        An idle connection may end while the request is sent. The request is then sent again on another one, which is
        safe because predictions have no side effects.
        """
        while True:
            content, http = bytearray(), self._connections.in_use()
            watch = ConnectionWatch(deadline)
            try:
                with watch, http.stream(**self._request(call, deadline, watch.trace)) as response:
                    for part in response.iter_raw():
                        add_part(content, part, call.max_answer_bytes)
                        deadline.bound_s(None)
                return response, bytes(content)
            except (TimeoutError, httpx2.TimeoutException) as error:
                raise self._timed_out() from error
            except UNREACHABLE as error:
                if not watch.was_idle:
                    raise self._unreachable(error) from error
