"""JSON documents: bounded in structure before they are parsed, because a short text can be a large document.

Parsing holds the interpreter lock, so other requests wait. Its time and memory grow with the number of values, of lists
and objects, and of texts. Each is counted in the bytes of a body within milliseconds, without the lock.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt
import orjson
import pydantic_core

from service.errors import InvalidRequestError, MalformedBodyError

MAX_VALUES: Final = 500_000
"""A batch of 10,000 pushes has fewer, with a pose, an index and an indicator each. To parse as many takes 50 ms."""
MAX_CONTAINERS: Final = 60_000
MAX_TEXTS: Final = 60_000
MAX_LONG_NUMBERS: Final = 60_000
LONG_DIGITS: Final = 20
"""Digits, with the point, of a number with an exponent. One that lies between two floats takes ten times as long."""
SHORT_BYTES: Final = 64 * 1024
"""Size up to which a number that is not finite is refused with the name of its field. In longer documents it is
malformed, because their parser takes a time that is linear in the digits of a number."""
_COUNTED: Final = (  # kind of thing, the characters that begin or end it, and how many of them it has
    ("lists and objects", b"[{", 1, MAX_CONTAINERS),
    ("texts", b'"', 2, MAX_TEXTS),
    ("values", b",", 1, MAX_VALUES),
)


def parse_json(content: bytes) -> Any:
    """Parse a JSON document in UTF-8, in bounded time and memory.

    Raises:
        InvalidRequestError: it has more values, texts, or lists and objects than any request.
        MalformedBodyError: the content is not JSON in UTF-8, or it is long and has a number that is not finite.
    """
    is_short = len(content) <= SHORT_BYTES
    if not is_short:
        _check_structure(content)
    try:
        return pydantic_core.from_json(content) if is_short else orjson.loads(content)
    except ValueError as error:
        reason = str(error)  # orjson's error holds the document: it must not outlive this call
    raise MalformedBodyError(f"body: received no JSON ({reason}); accepted is JSON in UTF-8")


def _check_structure(content: bytes) -> None:
    """Refuse a document that may be too large once it is parsed. Characters inside of texts count too."""
    codes = np.frombuffer(content, dtype=np.uint8)
    for kind, characters, each, limit in _COUNTED:
        if sum(int(np.count_nonzero(codes == character)) for character in characters) > each * limit:
            raise _too_many(kind, limit)
    if _count_long_numbers(codes) > MAX_LONG_NUMBERS:
        raise _too_many(f"numbers of {LONG_DIGITS} digits and more with an exponent", MAX_LONG_NUMBERS)


def _count_long_numbers(codes: npt.NDArray[np.uint8]) -> int:
    """Return how many runs of ``LONG_DIGITS`` digits and points have an exponent behind them."""
    runs, length = codes - np.uint8(ord(".")) <= ord("9") - ord("."), 1  # with the slash between point and digits
    while length < LONG_DIGITS:
        step = min(length, LONG_DIGITS - length)
        runs, length = runs[:-step] & runs[step:], length + step
    return int(np.count_nonzero(runs[:-1] & (codes[LONG_DIGITS:] | 0x20 == ord("e"))))


def _too_many(kind: str, limit: int) -> InvalidRequestError:
    return InvalidRequestError.at("body", f"more than {limit} {kind}", f"up to {limit} {kind}")
