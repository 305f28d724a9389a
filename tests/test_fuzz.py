"""Generated requests, by schema and by mutation: no status 5xx, bounded memory, and answers as documented.

``CAZSL_FUZZ_REQUESTS`` is the number of mutations. ``make fuzz`` sends 100,000 and prints the count of each status.
"""

import asyncio
import os
import random
import re
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, assume, settings
from hypothesis import strategies as st
from starlette.types import Message

from service.api.v1.uploads import FORM_TYPE, IMAGE_TYPES
from service.app import Service, create_app
from service.settings import Settings
from tests.running_service import ROOT, shipped_models
from tests.valid_bodies import (
    cannot_be_sent_as_form,
    make_batch_valid,
    make_image_valid,
    make_inference_valid,
    make_map_valid,
    make_plan_valid,
    make_push_valid,
    make_refine_valid,
    make_rollout_valid,
    make_upload_valid,
    picture,
)

REQUESTS = int(os.environ.get("CAZSL_FUZZ_REQUESTS", "5000"))
GROWTH_MIB = 96.0
REQUEST = re.compile(rb"(?P<method>[A-Z]+) (?P<path>/[!-~]*) HTTP/1.1\r\n(?P<head>.*?)\r\n\r\n(?P<body>.*)", re.DOTALL)
PIECES = (b"0", b"-", b"1e999", b"NaN", b"null", b"[", b"]", b"{", b"}", b'"', b",", b":", b"\\ud800", b"\x00", b"\xff")


def make_app() -> Service:
    """Create the service over the shipped models."""
    models = shipped_models(Path(tempfile.mkdtemp()))
    app = create_app(Settings(poll_interval_s=3600), models)
    assert isinstance(app, Service)
    return app


schema = schemathesis.openapi.from_asgi("/openapi.json", make_app())
for kind in IMAGE_TYPES:
    schemathesis.openapi.media_type(kind, st.integers(0, 2**32).map(picture))
MAKE_VALID: dict[str, Callable[[dict[str, Any]], None]] = {
    "/v1/predict": make_push_valid,
    "/v1/predict/batch": make_batch_valid,
    "/v1/predict/image": make_upload_valid,
    "/v1/contexts": make_image_valid,
    "/v1/rollout": make_rollout_valid,
    "/v1/push-map": make_map_valid,
    "/v1/plan": make_plan_valid,
    "/v1/contexts/refine": make_refine_valid,
    "/v2/models/{name}/infer": make_inference_valid,
    "/v2/models/{name}/versions/{version}/infer": make_inference_valid,
}


@schema.parametrize()
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
def test_every_answer_is_as_documented(case: schemathesis.Case[Any]) -> None:
    """Run every check of schemathesis on every operation: status, media type, schema, method, valid and invalid bodies.

    Bodies are first made valid by the rules that no schema expresses. See ``tests.valid_bodies``.
    """
    make_valid = MAKE_VALID.get(case.operation.path)
    if case.meta is not None and case.meta.generation.mode.is_negative:
        assume(case.media_type != FORM_TYPE or not cannot_be_sent_as_form(case.body))
    elif make_valid is not None and isinstance(case.body, dict):
        make_valid(case.body)
    case.call_and_validate()


class Corpus:
    """Mutations of the requests in tests/attacks/http."""

    def __init__(self, seed: int) -> None:
        files = sorted((ROOT / "tests" / "attacks" / "http").glob("*.http"))
        self._found = [match for path in files if (match := REQUEST.fullmatch(path.read_bytes()))]
        self._random = random.Random(seed)  # noqa: S311  # a seed makes the test repeatable

    def request(self) -> tuple[str, str, list[tuple[bytes, bytes]], bytes]:
        """Return method, path, headers and a body with up to four parts cut, repeated or replaced."""
        match = self._random.choice(self._found)
        lines = [line.partition(b": ") for line in match["head"].split(b"\r\n")]
        headers = [(name.lower(), value) for name, _, value in lines if name.lower() != b"content-length"]
        body = match["body"]
        for _ in range(self._random.randint(0, 4)):
            start = self._random.randint(0, len(body))
            end = min(len(body), start + self._random.randint(0, 8))
            put = self._random.choice((*PIECES, body[start:end] * 3, self._random.randbytes(3)))
            body = body[:start] + put + body[end:]
        path = match["path"].decode("ascii").partition("?")[0]
        return match["method"].decode("ascii"), path, headers, body


async def ask(app: Service, method: str, path: str, headers: list[tuple[bytes, bytes]], body: bytes) -> int:
    """Send one request to the app and return the status of the answer."""
    sent: list[Message] = []

    async def receive() -> Message:
        """Return the body in one message."""
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: Message) -> None:
        """Keep the messages of the answer."""
        sent.append(message)

    scope: dict[str, Any] = {
        "type": "http",
        "http_version": "1.1",
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "scheme": "http",
        "query_string": b"",
        "headers": headers,
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 8000),
    }
    await app(scope, receive, send)
    return int(sent[0]["status"])


def rss_mib() -> float:
    """Return the resident memory of this process in MiB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def test_no_mutation_of_an_attack_gets_a_5xx(caplog: pytest.LogCaptureFixture) -> None:
    """Send mutated attacks. No status is 5xx, memory is bounded, and a prediction is answered after the last one."""
    caplog.set_level("ERROR")
    corpus, counts = Corpus(seed=0), Counter[tuple[str, int]]()
    plain = b'{"pusher": {"x": 0, "y": 0, "angle": 0}, "context": {"descriptor": "1a2b3c4a"}}'

    async def scenario() -> float:
        """Send all mutations, and return the growth of memory."""
        app, before = make_app(), 0.0
        async with app.router.lifespan_context(app):
            for number in range(REQUESTS):
                method, path, headers, body = corpus.request()
                status = await ask(app, method, path, headers, body)
                assert status < 500, (method, path, headers, body)
                counts[path if path.startswith(("/v1/predict", "/v1/contexts", "/v2")) else "others", status] += 1
                if number == REQUESTS // 5:
                    before = rss_mib()
            headers = [(b"host", b"test"), (b"content-type", b"application/json")]
            assert await ask(app, "POST", "/v1/predict", headers, plain) == 200
            return rss_mib() - before

    growth = asyncio.run(scenario())
    print(f"\n{REQUESTS} requests, memory grew by {growth:.1f} MiB after the first fifth")  # noqa: T201  # the report
    for (path, status), count in sorted(counts.items()):
        print(f"{count:8d}  {status}  {path}")  # noqa: T201
    assert growth < GROWTH_MIB
    assert {status for _, status in counts} >= {200, 400, 404, 415, 422}
