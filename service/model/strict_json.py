"""Strict JSON: the reader of every document of a registry, and the rules of the short texts and numbers in it.

A document that a registry accepts can be written, read by another JSON reader, and shown. So the reader refuses names
that occur twice, NaN and Infinity, numbers that overflow, half characters (lone surrogates), a byte order mark, and
documents that are large or deep. ``check_text`` and ``check_integer`` are the rules of single values. A writer applies
the same rules before it writes, so that it writes only documents that the reader accepts.
"""

import json
import math
import unicodedata
from typing import Any, Final

MAX_DEPTH: Final = 32
MAX_NAMES: Final = 10_000  # of one object
MAX_DIGITS: Final = 19  # of an integer: numbers below 2**63, as other readers hold them
MAX_TEXT: Final = 4_000  # characters of a short text: a name, a sentence, a reason
LARGEST: Final = 2**63 - 1
_CONTROLS: Final = frozenset(("Cc", "Cs", "Zl", "Zp"))  # controls, half characters, line and paragraph separators
_TURNS: Final = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")  # reorder the text behind them


def read_json(content: bytes, limit_bytes: int) -> Any:
    """Read a JSON document in UTF-8.

    Raises:
        ValueError: it breaks a rule of this module. The message names the rule, and repeats no text of the document.
    """
    if len(content) > limit_bytes:
        raise ValueError(f"{len(content)} bytes; at most {limit_bytes} are accepted")
    try:
        text = content.decode("utf-8")
        found = json.loads(
            text,
            object_pairs_hook=_object,
            parse_constant=_constant,
            parse_float=_fraction,
            parse_int=_integer,
        )
    except UnicodeDecodeError as error:
        raise ValueError("not a JSON document in UTF-8") from error
    except json.JSONDecodeError as error:
        raise ValueError(f"not a JSON document in UTF-8 (line {error.lineno})") from error
    except RecursionError as error:
        raise ValueError(f"nested deeper than {MAX_DEPTH}") from error
    _check_nesting(found, check_texts="\\u" in text)
    return found


def check_text(text: str, limit: int = MAX_TEXT) -> str:
    """Return a short text: one line without control characters.

    Raises:
        ValueError: it is too long, or holds a control character or a half character.
    """
    if len(text) > limit:
        raise ValueError(f"a text of {len(text)} characters; at most {limit} are accepted")
    if not text.isprintable() and any(unicodedata.category(char) in _CONTROLS or char in _TURNS for char in text):
        raise ValueError("a text with control characters or half characters")
    return text


def check_integer(number: object, least: int = 0, most: int = LARGEST) -> int:
    """Return an integer within bounds. A boolean is none, and neither is a fraction.

    Raises:
        ValueError: it is another value.
    """
    if type(number) is not int or not least <= number <= most:
        raise ValueError(f"not an integer from {least} to {most}")
    return number


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(pairs) > MAX_NAMES:
        raise ValueError(f"an object of {len(pairs)} names; at most {MAX_NAMES} are accepted")
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("an object with a name that occurs twice")
    return found


def _constant(_: str) -> Any:
    raise ValueError("NaN or Infinity, which JSON does not have")


def _fraction(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError("a number that is too large")
    return number


def _integer(text: str) -> int:
    if len(text.removeprefix("-")) > MAX_DIGITS or not -LARGEST <= (number := int(text)) <= LARGEST:
        raise ValueError("a number that is too large")
    return number


def _check_nesting(found: Any, check_texts: bool) -> None:
    """Walk a document level by level. Only escapes can bring half characters into texts that were UTF-8."""
    kinds = dict | list | str if check_texts else dict | list
    level, depth = [found], 0
    while level:
        if depth > MAX_DEPTH:
            raise ValueError(f"nested deeper than {MAX_DEPTH}")
        below: list[Any] = []
        for value in level:
            if isinstance(value, str):
                _check_halves(value)
            elif isinstance(value, dict):
                below += (*value, *value.values()) if check_texts else value.values()
            elif isinstance(value, list):
                below += value
        level, depth = [value for value in below if isinstance(value, kinds)], depth + 1


def _check_halves(text: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise ValueError("a text with half a character") from error
