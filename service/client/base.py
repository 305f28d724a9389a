"""Base of both clients: address, API key, timeout, retries, and the limit on the size of an answer."""

import random
from typing import Any, Final, TypeVar

import httpx2

import service
from service.client.calls import Call
from service.client.errors import TimedOutError, UnreachableError, UnreadableAnswerError
from service.client.retries import Retries, retry_after_s

DEFAULT_URL: Final = "http://localhost:8000"
IN_PROCESS_URL: Final = "http://in-process"
ONE_ATTEMPT: Final = Retries(attempts=1)
MAX_ANSWER_BYTES: Final = 64 << 20  # the largest answer, 10,000 pushes in the world frame, has 3 MB
# No compressed answers: their size after decompression is unknown.
_HEADERS: Final = {"User-Agent": f"cazsl/{service.__version__}", "Accept-Encoding": "identity"}

T = TypeVar("T")


class ClientBase:
    """Common part of both clients. It sends no requests itself."""

    def __init__(self, url: str, key: str | None, timeout_s: float, retries: Retries | None) -> None:
        self._url = url.rstrip("/")
        self._headers = dict(_HEADERS) if key is None else {**_HEADERS, "Authorization": f"Bearer {key}"}
        self._timeout_s = timeout_s
        self._retries = retries or Retries()
        self._draw = random.SystemRandom().random  # the system's source: forked processes must not draw equal pauses

    def _request(self, call: Call[T]) -> dict[str, Any]:
        """Return the keyword arguments of the request for httpx."""
        headers = {**self._headers, **call.body.get("headers", {})}
        url = self._url + call.path
        return {"method": call.method, "url": url, "timeout": self._timeout_s, **call.body, "headers": headers}

    def _pause_s(self, attempt: int, response: httpx2.Response) -> float | None:
        asked_s = retry_after_s(response.headers.get("retry-after"))
        return self._retries.pause_s(attempt, response.status_code, asked_s, self._draw)

    def _timed_out(self) -> TimedOutError:
        return TimedOutError(f"{self._url} gave no complete answer within {self._timeout_s:g} s")

    def _unreachable(self, error: httpx2.TransportError) -> UnreachableError:
        cause = str(error) or type(error).__name__
        return UnreachableError(
            f"{self._url} cannot be reached: {cause}; is the service running, and is this its address?"
        )


def add_part(content: bytearray, part: bytes) -> None:
    """Append a part of an answer.

    Raises:
        UnreadableAnswerError: the answer has more than ``MAX_ANSWER_BYTES``.
    """
    content += part
    if len(content) > MAX_ANSWER_BYTES:
        raise UnreadableAnswerError(f"the answer has more than {MAX_ANSWER_BYTES} bytes")
