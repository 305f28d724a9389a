"""The blocking client; see ``service.client``, from where it is imported."""

import time
from collections.abc import Sequence
from types import TracebackType
from typing import Self, TypeVar

import httpx2
import numpy.typing as npt

from service.client import calls
from service.client.base import DEFAULT_URL, IN_PROCESS_URL, ONE_ATTEMPT, Caller, add_part
from service.client.calls import Call, Context, Image, Predictions
from service.client.retries import Retries, retry_after_s
from service.schemas.contexts import VisualContextBody
from service.schemas.models import ModelBody, ModelsBody, ModelVersionDetailBody
from service.schemas.predictions import PredictResponse

T = TypeVar("T")


class Client(Caller):
    """A blocking client; may be shared by threads, and keeps connections open until it is closed.

    Args:
        url: of the service.
        key: an API key, where the service wants one.
        timeout_s: for each attempt, in s: to connect, to send, and to have the whole answer.
        retries: how often and how soon to ask again after a 503, and after nothing else.
        http: an httpx client of your own, for TLS, proxies or other transports; it is closed with this one.

    Every method raises:
        ProblemError: the service refused; ``code``, ``detail`` and ``faults`` say why.
        UnreachableError: nobody answered, or TimedOutError: not in time.
        UnreadableAnswerError: what answered is no CAZSL service.
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
        self._http = http or httpx2.Client()

    @classmethod
    def local(cls, registry: str = "models", *, require_signature: str = "") -> Self:
        """A client without a service: the models of a registry as it is now, answering in this process.

        Args:
            registry: a folder of models, or s3://bucket/prefix.
            require_signature: public keys of which one must have signed a version, as CAZSL_REQUIRE_SIGNATURE.

        Raises:
            RegistryError, ModelNotReadyError: the registry, or every model in it, cannot be used.
        """
        from service.client.local import InProcess  # loads the runtime, which those who ask a service need not have

        http = httpx2.Client(transport=InProcess.over(registry, require_signature))
        return cls(IN_PROCESS_URL, retries=ONE_ATTEMPT, http=http)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def predict(
        self,
        pusher: npt.ArrayLike,
        context: Context | None = None,
        *,
        model: str | None = None,
        object_pose: npt.ArrayLike | None = None,
    ) -> PredictResponse:
        """Where does the object end up after this push, and how sure is that?

        Args:
            pusher: (3,) x and y of the pusher's tip in m, direction of the push in rad; in the object's frame, or in
                the world where ``object_pose`` is given.
            context: the object: a descriptor such as ``1a2b3c4a``, a ``ContextBody``, or what ``make_context`` gave;
                None for models that know nothing of it.
            model: name, name@alias or name@version; None: the champion for this kind of context.
            object_pose: (3,) where the object is in the world; the answer is then in it too, with its covariance.
        """
        return self._send(calls.predict(pusher, context, model, object_pose))

    def predict_batch(
        self,
        pushers: npt.ArrayLike,
        contexts: Context | Sequence[Context] | None = None,
        context_index: npt.ArrayLike | None = None,
        *,
        model: str | None = None,
        object_poses: npt.ArrayLike | None = None,
    ) -> Predictions:
        """The same for up to 10,000 pushes.

        Args:
            pushers: (n, 3) as in ``predict``.
            contexts: one object for all pushes, one per push, or several with an index per push.
            context_index: (n,) for each push the place of its object in ``contexts``, from 0.
            model: as in ``predict``.
            object_poses: (1, 3) or (n, 3) where the objects are in the world, as in ``predict``.
        """
        return self._send(calls.predict_batch(pushers, contexts, context_index, model, object_poses))

    def predict_image(
        self,
        image: Image,
        pushers: npt.ArrayLike,
        *,
        model: str | None = None,
        object_poses: npt.ArrayLike | None = None,
    ) -> Predictions:
        """The same for pushes (n, 3) of the object in an image: a file's path, or its content.

        An image that is asked about again is better turned into a context once: ``make_context``.
        """
        return self._send(calls.predict_image(image, pushers, model, object_poses))

    def make_context(self, image: Image) -> VisualContextBody:
        """What does a model see of this image? To be given to predictions as their context, and to be looked at."""
        return self._send(calls.make_context(image))

    def list_models(self) -> ModelsBody:
        """Every model that is served, with its versions and aliases."""
        return self._send(calls.list_models())

    def show_model(self, name: str) -> ModelBody:
        """One model."""
        return self._send(calls.show_model(name))

    def show_version(self, name: str, version: int) -> ModelVersionDetailBody:
        """One version, with its manifest and its card."""
        return self._send(calls.show_version(name, version))

    def _send(self, call: Call[T]) -> T:
        attempt = 0
        while True:
            attempt += 1
            response, content = self._exchange(call)
            pause_s = self._pause_s(attempt, response)
            if pause_s is None:
                return call.read(response.status_code, content, retry_after_s(response.headers.get("retry-after")))
            time.sleep(pause_s)

    def _exchange(self, call: Call[T]) -> tuple[httpx2.Response, bytes]:
        """One attempt; each wait for bytes is bounded, and so is all of them together."""
        end_s = time.monotonic() + self._timeout_s
        content = bytearray()
        try:
            with self._http.stream(**self._request(call)) as response:
                for part in response.iter_raw():
                    add_part(content, part)
                    if time.monotonic() > end_s:
                        raise self._late()
        except httpx2.TimeoutException as error:
            raise self._late() from error
        except httpx2.TransportError as error:
            raise self._unreachable(error) from error
        return response, bytes(content)
