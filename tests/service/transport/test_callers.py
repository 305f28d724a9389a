"""Callers are verified keys or addresses, and never the text of a header."""

from pathlib import Path
from typing import Any

import pytest

from service.errors import ForbiddenError, MissingKeyError
from service.transport.callers import Callers, caller_of, needed_scope
from service.transport.keys import Grant, Keys, Scope


def scope_of(path: str, key: str | None = None, client: object = ("192.0.2.1", 5)) -> dict[str, Any]:
    """Return the scope of a request."""
    headers = [] if key is None else [(b"authorization", key.encode())]
    return {"type": "http", "path": path, "headers": headers, "client": client}


@pytest.mark.parametrize(
    ("client", "caller"),
    [
        (("192.0.2.1", 5), "address:192.0.2.1"),
        (("2001:db8::1", 5), "address:2001:db8::/64"),
        (("2001:db8:0:0:ffff::1", 5, 0, 0), "address:2001:db8::/64"),
        (("2001:db8:0:1::1", 5), "address:2001:db8:0:1::/64"),
        (("::ffff:192.0.2.1", 5), "address:192.0.2.1"),
        (("fe80::1%eth0", 5), "address:fe80::/64"),
        (("testclient", 5), "address:testclient"),
        (None, "address:"),
    ],
)
def test_without_keys_a_caller_is_an_address(client: object, caller: str) -> None:
    """An IPv6 network is one caller, and an IPv4 address is one however it is written."""
    callers = Callers(Keys(None))
    for key in (None, "Bearer junk", "bearer Junk"):
        assert callers.admit(scope_of("/v1/predict", key, client)) == caller


def test_with_keys_a_caller_is_the_name_of_its_key(tmp_path: Path) -> None:
    """Where a key is needed it is checked, and its name is the caller. Elsewhere the address is."""
    grant, key = Grant.new("robot", frozenset({Scope.PREDICT}))
    (tmp_path / "keys").write_text(grant.line())
    callers = Callers(Keys(tmp_path / "keys"))
    for spelling in (f"Bearer {key}", f"bearer {key}", f"BEARER  {key}"):
        assert callers.admit(scope_of("/v1/predict", spelling)) == "key:robot"
        assert callers.admit(scope_of("/livez", spelling)) == "address:192.0.2.1"
    with pytest.raises(ForbiddenError):
        callers.admit(scope_of("/metrics", f"Bearer {key}"))
    for wrong in (None, "Bearer junk"):
        with pytest.raises(MissingKeyError):
            callers.admit(scope_of("/v1/models", wrong))


@pytest.mark.parametrize(
    ("path", "needed"),
    [
        ("/v1/predict", Scope.PREDICT),
        ("/v1/nothing", Scope.PREDICT),
        ("/v2", Scope.PREDICT),
        ("/v2/models/a/infer", Scope.PREDICT),
        ("/metrics", Scope.METRICS),
        ("/v2/health/live", None),
        ("/v2/health/ready", None),
        ("/livez", None),
        ("/readyz", None),
        ("/docs", None),
        ("/openapi.json", None),
        ("/", None),
    ],
)
def test_a_path_says_which_scope_it_needs(path: str, needed: Scope | None) -> None:
    """All of /v1 and /v2 needs a key, except health."""
    assert needed_scope(path) is needed


def test_a_key_is_checked_once(tmp_path: Path) -> None:
    """A request keeps its caller, or its refusal."""
    grant, key = Grant.new("robot", frozenset({Scope.PREDICT}))
    (tmp_path / "keys").write_text(grant.line())
    callers = Callers(Keys(tmp_path / "keys"))
    good, bad = scope_of("/v1/predict", f"Bearer {key}"), scope_of("/v1/predict", "Bearer junk")
    callers.admit(good)
    with pytest.raises(MissingKeyError):
        callers.admit(bad)
    (tmp_path / "keys").unlink()
    assert callers.admit(good) == caller_of(good) == "key:robot"
    with pytest.raises(MissingKeyError):
        callers.admit(bad)
