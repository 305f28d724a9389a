"""Base of both clients: address, API key, timeout, retries, and the limit on the size of an answer."""

import random
from collections.abc import Callable
from typing import Any, Final, NoReturn, TypeVar

import httpx2

import service
from service.client.calls import Call
from service.client.connections import parse_address
from service.client.deadline import Deadline
from service.client.errors import ClientSetupError, TimedOutError, UnreachableError, UnreadableAnswerError
from service.client.retries import Retries, retry_after_s

DEFAULT_URL: Final = "http://localhost:8000"
IN_PROCESS_URL: Final = "http://in-process"
ONE_ATTEMPT: Final = Retries(attempts=1)
# No compressed answers: their size after decompression is unknown.
_HEADERS: Final = {"User-Agent": f"cazsl/{service.__version__}", "Accept-Encoding": "identity"}

T = TypeVar("T")


class ClientBase:
    """Common part of both clients. It sends no requests itself."""

    def __init__(self, url: str, key: str | None, timeout_s: float, retries: Retries | None) -> None:
        address = parse_address(url)
        if not timeout_s > 0.0:
            raise ClientSetupError(f"timeout_s: received {timeout_s}; accepted is a positive number of seconds, or inf")
        if key is not None and not (key and key.isascii() and key.isprintable() and key == key.strip()):
            raise ClientSetupError(
                "key: received an empty text, or one with spaces around it or characters that no key has; "
                "accepted is a key as `cazsl keys new` shows it"
            )
        if key is not None and address.userinfo:
            raise ClientSetupError("url: received a name or password beside a key; accepted is one of them")
        self._url = url.rstrip("/")
        self._shown_url = str(address.copy_with(userinfo=b"")).rstrip("/") if address.userinfo else self._url
        self._headers = dict(_HEADERS) if key is None else {**_HEADERS, "Authorization": f"Bearer {key}"}
        self._timeout_s = timeout_s
        self._retries = retries or Retries()
        self._draw = random.SystemRandom().random  # the system's source: forked processes must not draw equal pauses

    def _request(self, call: Call[T], deadline: Deadline, trace: Callable[..., Any]) -> dict[str, Any]:
        """Return the keyword arguments of the request for httpx, which calls ``trace`` at each step.

        Raises:
            TimeoutError: no time is left.
        """
        return {
            "method": call.method,
            "url": self._url + call.path,
            "timeout": deadline.bound_s(self._timeout_s),
            "extensions": {"trace": trace},
            **call.body,
            "headers": {**self._headers, **call.body.get("headers", {})},
        }

    def _pause_s(self, attempt: int, response: httpx2.Response, deadline: Deadline) -> float | None:
        """Return the pause before the next attempt in s, or None if there is none, or no time for it."""
        asked_s = retry_after_s(response.headers.get("retry-after"))
        pause_s = self._retries.pause_s(attempt, response.status_code, asked_s, self._draw)
        return None if pause_s is None or pause_s >= deadline.left_s() else pause_s

    def _timed_out(self) -> TimedOutError:
        return TimedOutError(f"{self._shown_url} gave no complete answer within {self._timeout_s:g} s")

    def __reduce__(self) -> NoReturn:
        raise TypeError("a client has connections and is not pickled: create one in each process")

    def _unreachable(self, error: Exception) -> UnreachableError:
        while isinstance(error, ExceptionGroup):
            error = error.exceptions[0]
        cause = str(error) or type(error).__name__
        return UnreachableError(
            f"{self._shown_url} cannot be reached: {cause}; is the service running, and is this its address?"
        )


def add_part(content: bytearray, part: bytes, max_bytes: int) -> None:
    """Append a part of an answer.

    Raises:
        UnreadableAnswerError: the answer is larger than any answer to this call.
    """
    content += part
    if len(content) > max_bytes:
        raise UnreadableAnswerError(f"the answer has more than {max_bytes} bytes; is this a CAZSL service?")
