"""Worst requests: every field of every route, filled with the worst that the limits allow.

The OpenAPI document names the routes, parameters, media types and fields, so a new field is filled without a change
here. The largest valid requests are in ``worst_valid``.
"""

import gzip
import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

MARK: Final = "Zq7mark"
"""A text in every name and text that is sent. No answer may repeat it."""
HEADER_BYTES: Final = 15 * 1024  # 16 KiB are the limit of a head
TARGET_BYTES: Final = 3900  # 4 KiB are the limit
BOUNDARY: Final = "worst"
_PLACEHOLDER: Final = "worst value"
_JSON: Final = {"Content-Type": "application/json"}
_GZIP: Final = _JSON | {"Content-Encoding": "gzip"}
_BOMB: Final = 16  # size of a body once it is decompressed, in times of the limit
_FORM: Final = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
# A unit is repeated up to a size, and once more up to just below a limit of structure, where it is parsed.
_UNITS: Final[dict[str, tuple[bytes, bytes, bytes]]] = {
    "zeros": (b"[", b"0,", b"0]"),
    "numbers of 17 digits": (b"[", b"-0.12345678901234567,", b"0]"),
    "numbers of 25 digits": (b"[", b"7" * 25 + b",", b"0]"),
    "numbers between two floats": (b"[", b"2.22507385850720113606e-308,", b"0]"),
    "numbers of 4,000 digits": (b"[", b"7" * 4000 + b",", b"0]"),
    "not finite": (b"[", b"NaN,", b"0]"),
    "nulls": (b"[", b"null,", b"null]"),
    "lists": (b"[", b"[],", b"[]]"),
    "objects": (b"[", b"{},", b"{}]"),
    "texts": (b"[", b'"",', b'""]'),
    "rows": (b"[", b"[0,0,0],", b"[0,0,0]]"),
    "deep lists": (b"", b"[", b""),
    "deep objects": (b"", b'{"a":', b""),
    "a long text": (b'"', MARK.encode(), b'"'),
    "escapes": (b'"', b"\\u00e9", b'"'),
    "a long number": (b"", b"7", b""),
    "a long name": (b'{"', MARK.encode(), b'":0}'),
    "a long name of a list": (b'{"', MARK.encode(), b'":[[0]]}'),
}
_MAX_VALUES, _MAX_CONTAINERS, _MAX_TEXTS = 490_000, 59_000, 59_000
_PARAMETERS: Final = {
    "a long text": MARK.encode() * (TARGET_BYTES // len(MARK)),
    "digits": b"9" * TARGET_BYTES,
    "escapes": b"%F0%9F%98%80" * (TARGET_BYTES // 12),
    "half a character": b"%ff" * (TARGET_BYTES // 3),
    "references": b"a@" * (TARGET_BYTES // 2),
}
_HEADERS: Final = (
    "Accept", "Accept-Encoding", "Authorization", "Content-Encoding", "Content-Type", "Cookie", "Expect", "Host",
    "If-None-Match", "Inference-Header-Content-Length", "Range", "Traceparent", "X-Forwarded-For", "X-Request-ID", MARK,
)  # fmt: skip


@dataclass(frozen=True)
class WorstRequest:
    """A request. Its body is made when it is asked for, because it may have megabytes."""

    route: str
    kind: str
    method: str
    target: bytes
    headers: dict[str, str] = field(default_factory=dict)
    body: Callable[[], bytes] = bytes


def worst_requests(document: dict[str, Any], size: int, route: str | None = None) -> Iterator[WorstRequest]:
    """Yield for each route of an OpenAPI document each worst request, with bodies of up to ``size`` bytes.

    Args:
        document: the OpenAPI document.
        size: maximum bytes of a body.
        route: template of the only route. None: every route.
    """
    for path, operations in document["paths"].items():
        for method, operation in operations.items() if route in (None, path) else ():
            yield from _heads(path, method.upper(), operation)
            content = operation.get("requestBody", {}).get("content", {})
            for media_type, media in content.items():
                if media_type == "application/json":
                    yield from _json_bodies(document, path, media, size)
                elif media_type == "multipart/form-data":
                    yield from _forms(document, path, media, size)
                else:
                    for kind, body in (("noise", bytes(range(256))), ("zeros", bytes(256))):
                        content_type = {"Content-Type": media_type}
                        yield WorstRequest(
                            path, f"{media_type}: {kind}", "POST", _target(path), content_type, _of(body, size)
                        )


def values(size: int) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the JSON of each worst value: as many as fit into ``size``, and as many as are parsed."""
    for kind, (start, unit, end) in _UNITS.items():
        whole = size // len(unit)
        parsed = min(
            whole,
            _MAX_VALUES // max(1, unit.count(b",")),
            _MAX_CONTAINERS // max(1, unit.count(b"[") + unit.count(b"{")),
            2 * _MAX_TEXTS // max(1, unit.count(b'"')),
        )
        for count in sorted({whole, parsed}):
            yield f"{count:,} x {kind}", start + unit * count + end
    names = (f'"{MARK}{number:x}":0' for number in itertools.count())
    for count in sorted({min(_MAX_TEXTS, size // 20), size // 20}):
        yield f"{count:,} x fields", b"{" + ",".join(itertools.islice(names, count)).encode() + b"}"


def _heads(path: str, method: str, operation: dict[str, Any]) -> Iterator[WorstRequest]:
    """Yield requests with the worst parameters of the path, queries and headers."""
    for parameter in operation.get("parameters", ()):
        for kind, value in _PARAMETERS.items():
            target = _target(path, {parameter["name"]: value})
            yield WorstRequest(path, f"{parameter['name']}: {kind}", method, target, _JSON)
    for kind, value in _PARAMETERS.items():
        yield WorstRequest(path, f"query: {kind}", method, _target(path) + b"?" + MARK.encode() + b"=" + value, _JSON)
    for name in _HEADERS:
        for kind, text in (("a long text", MARK), ("digits", "9"), ("parts", "a/b;q=0.1,")):
            headers = _JSON | {name: text * (HEADER_BYTES // len(text))}
            yield WorstRequest(path, f"header {name}: {kind}", method, _target(path), headers)


def _json_bodies(document: dict[str, Any], path: str, media: dict[str, Any], size: int) -> Iterator[WorstRequest]:
    """Yield requests with the worst value in place of each field, beside it, and of the whole body."""
    example = next(iter(media["examples"].values()))["value"]
    for kind, value in values(size):
        for place in dict.fromkeys([(), *places(document, media["schema"])]):
            where = f"{'.'.join(place) or 'body'}: {kind}"
            body = _within(*_around(example, place), value)
            yield WorstRequest(path, where, "POST", _target(path), _JSON, body)
            if path.startswith("/v2"):
                yield WorstRequest(path, f"{where}, gzip", "POST", _target(path), _GZIP, _zipped(body))
    if path.startswith("/v2"):
        for kind, unit in (("spaces", b" "), ("zeros", b"0,"), ("lists", b"[")):
            bomb = _zipped(_of(unit, _BOMB * size))
            yield WorstRequest(path, f"body: {_BOMB} times as many {kind}, gzip", "POST", _target(path), _GZIP, bomb)
        twice = _zipped(_zipped(_of(b"0,", _BOMB * size)))
        yield WorstRequest(path, "body: compressed twice, gzip", "POST", _target(path), _GZIP, twice)


def _forms(document: dict[str, Any], path: str, media: dict[str, Any], size: int) -> Iterator[WorstRequest]:
    """Yield forms with the worst value of each field, and with the worst parts."""
    mark = MARK.encode()
    for name in [*media["schema"]["properties"], MARK]:
        for kind, value in values(size):
            yield WorstRequest(path, f"form {name}: {kind}", "POST", _target(path), _FORM, _form(name.encode(), value))
    odd: dict[str, Callable[[], bytes]] = {
        "a long name of a field": _form(mark * (size // len(mark)), b"0"),
        "a long name of a file": _form(b'image"; filename="' + mark * (size // len(mark)), b"0"),
        "many parts": lambda: _part(b"pusher", b"0") * (size // 60) + _END,
        "many files": lambda: _part(b'image"; filename="a', b"0") * (size // 80) + _END,
        "many headers of a part": lambda: b"--worst\r\n" + b"X-A: b\r\n" * (size // 8) + b"\r\n0\r\n" + _END,
        "a preamble": lambda: b"\r\n--wors" * (size // 8) + _part(b"pusher", b"0") + _END,
        "almost a boundary": _form(b"pusher", b"\r\n--wors" * (size // 8)),
        "line ends": _form(b"pusher", b"\r\n" * (size // 2)),
        "no end": lambda: _part(b"pusher", b"\r" * size),
    }
    for kind, made in odd.items():
        yield WorstRequest(path, f"form: {kind}", "POST", _target(path), _FORM, made)


def places(document: dict[str, Any], schema: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield the path of each field of a schema, and of a field that no schema has. ``0`` is an item of a list."""
    if "$ref" in schema:
        found: Any = document
        for part in schema["$ref"].removeprefix("#/").split("/"):
            found = found[part]
        schema = found
    for form in (*schema.get("anyOf", ()), *schema.get("allOf", ())):
        yield from places(document, form)
    if schema.get("items"):
        yield ("0",)
        yield from (("0", *place) for place in places(document, schema["items"]))
    properties = schema.get("properties")
    if properties is not None or schema.get("type") == "object":
        yield (MARK,)
    for name, inner in (properties or {}).items():
        yield (name,)
        yield from ((name, *place) for place in places(document, inner))


def _around(example: Any, place: tuple[str, ...]) -> tuple[bytes, bytes]:
    """Return the JSON of an example before and after a place in it, whose value is left out."""
    before, after = json.dumps(_put(json.loads(json.dumps(example)), place)).split(f'"{_PLACEHOLDER}"')
    return before.encode(), after.encode()


def _put(found: Any, place: tuple[str, ...]) -> Any:
    """Return a document with the placeholder at a place, with lists and objects on the way."""
    if not place:
        return _PLACEHOLDER
    if place[0] == "0":
        rows = found if isinstance(found, list) and found else [None]
        return [_put(rows[0], place[1:]), *rows[1:]]
    inner = found if isinstance(found, dict) else {}
    return {**inner, place[0]: _put(inner.get(place[0]), place[1:])}


def _target(path: str, given: dict[str, bytes] | None = None) -> bytes:
    """Return the target of a path template, with a served model where a parameter is not given."""
    values = {"name": b"push-indicator", "version": b"1"} | (given or {})
    target = path.encode()
    for name, value in values.items():
        target = target.replace(b"{%s}" % name.encode(), value)
    return target


def _within(before: bytes, after: bytes, value: bytes) -> Callable[[], bytes]:
    return lambda: before + value + after


def _zipped(body: Callable[[], bytes]) -> Callable[[], bytes]:
    return lambda: gzip.compress(body(), 1)


def _of(unit: bytes, size: int) -> Callable[[], bytes]:
    return lambda: unit * (size // len(unit))


def _form(name: bytes, value: bytes) -> Callable[[], bytes]:
    return lambda: _part(name, value) + _END


def _part(name: bytes, value: bytes) -> bytes:
    return b'--%s\r\nContent-Disposition: form-data; name="%s"\r\n\r\n%s\r\n' % (BOUNDARY.encode(), name, value)


_END: Final = b"--%s--\r\n" % BOUNDARY.encode()
