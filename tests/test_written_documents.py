"""Writers and readers of a registry, walked with ugly values: all that is written can be read back and shown.

A writer refuses a value before a byte is written, or its reader accepts the result, and so do the JSON encoders of the
service. A reader that accepts a document that was written by hand returns one that the writers accept too.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import orjson
import pydantic_core
import pytest

from service.errors import CazslError
from service.model.manifest import CARD_FILE, MODEL_FILE, FileDigest, Manifest
from service.registry.registry import Registry
from service.storage.base import MAX_SIGNATURE_BYTES
from service.storage.bucket_state import StateFile
from service.storage.history import Event, ModelState
from service.transport.keys import Grant, Scope
from tests.fakes import draft_manifest, publish_fake

NAME = "push-indicator"
TEXTS: dict[str, str] = {
    "empty": "",
    "space": " ",
    "two words": "Robot 7",
    "comment": "a # b",
    "quotes": "\"'\\",
    "line feed": "a\nb",
    "carriage return": "a\rb",
    "tab": "a\tb",
    "zero": "\x00",
    "escape": "\x1b[31mred",
    "delete": "\x7f",
    "C1": "\x9b31m",
    "line separator": "\u2028",
    "reversed": "\u202egnp",
    "half a character": "\ud800",
    "byte that is not UTF-8": "\udcff",
    "byte order mark": "\ufeffa",
    "not a character": "\uffff",
    "other letters": "größer 名前 \U0001f916",
    "long": "x" * 5_000,
    "path": "../../up",
}
NUMBERS: dict[str, Any] = {
    "NaN": float("nan"),
    "infinity": float("inf"),
    "minus infinity": float("-inf"),
    "largest": 1.7e308,
    "smallest": 5e-324,
    "minus nothing": -0.0,
    "2**53": 2**53 + 1,
    "2**63": 2**63,
    "-2**63": -(2**63),
    "10**400": 10**400,
    "a boolean": True,
    "a text": "1",
    "nothing": None,
}


def tree(root: Path) -> dict[str, bytes]:
    """Return every file below a folder with its content."""
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def check_readable(registry: Registry) -> None:
    """Read all of a registry, and encode it as the service does."""
    for name in registry.names():
        state = registry.state(name)
        assert not state.faults
        history = registry.history(name)
        assert not history.problems
        for version in state.versions:
            manifest = registry.read(name, version).manifest
            document = pydantic_core.from_json(manifest.render(), allow_inf_nan=False)
            assert orjson.loads(orjson.dumps(document)) == document
        for event in history.events:
            orjson.dumps(event.as_document())
        assert history.state().aliases == state.aliases


def accepts(registry: Registry, write: Callable[[], object]) -> bool:
    """Write. Check that it is refused before a byte is written, or that all can be read back. Return which."""
    before = tree(registry.root)
    try:
        write()
    except CazslError:
        assert tree(registry.root) == before
        return False
    check_readable(registry)
    return True


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """Return a registry with two versions and two aliases."""
    found = Registry(tmp_path / "models")
    publish_fake(found)
    publish_fake(found, alias="canary")
    return found


def changed(value: Any, ugly: Any, kinds: tuple[type, ...]) -> Iterator[Any]:
    """Yield copies of a record, each with one value of these types replaced, at any depth."""
    if isinstance(value, kinds) and not isinstance(value, bool):
        yield ugly
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from (
                replace(value, **{field.name: part}) for part in changed(getattr(value, field.name), ugly, kinds)
            )
    elif isinstance(value, dict):
        for key in value:
            yield from ({**value, key: part} for part in changed(value[key], ugly, kinds))
            if str in kinds:
                yield {ugly if name == key else name: part for name, part in value.items()}
    elif isinstance(value, list | tuple) and value:
        yield from (type(value)((part, *value[1:])) for part in changed(value[0], ugly, kinds))


@pytest.mark.parametrize("ugly", TEXTS)
def test_a_draft_with_an_ugly_text_is_refused_or_read_back(registry: Registry, ugly: str) -> None:
    """Every text and every name in a manifest is walked, and the card."""
    drafts = list(changed(draft_manifest(), TEXTS[ugly], (str,)))
    assert len(drafts) > 20
    for draft in drafts:
        accepts(registry, partial(registry.publish, draft, b"fine", "card"))
    assert accepts(registry, lambda: registry.publish(draft_manifest(), b"fine", TEXTS[ugly])) == (
        ("character" not in ugly and "byte that" not in ugly) or ugly == "not a character"
    )


@pytest.mark.parametrize("ugly", NUMBERS)
def test_a_draft_with_an_ugly_number_is_refused_or_read_back(registry: Registry, ugly: str) -> None:
    """Every number in a manifest is walked."""
    drafts = list(changed(draft_manifest(), NUMBERS[ugly], (int, float)))
    assert len(drafts) > 20
    for draft in drafts:
        accepts(registry, partial(registry.publish, draft, b"fine", "card"))


@pytest.mark.parametrize("ugly", TEXTS)
def test_a_change_with_an_ugly_text_is_refused_or_read_back(registry: Registry, ugly: str) -> None:
    """Reasons, aliases and names are walked through every change."""
    text = TEXTS[ugly]
    accepts(registry, lambda: registry.point_alias(NAME, "champion", 2, reason=text))
    accepts(registry, lambda: registry.drop_alias(NAME, "canary", reason=text))
    accepts(registry, lambda: registry.remove(NAME, 1, reason=text))
    assert not accepts(registry, lambda: registry.point_alias(NAME, text, 2))
    assert not accepts(registry, lambda: registry.drop_alias(NAME, text))
    assert not accepts(registry, lambda: registry.point_alias(text, "champion", 2))
    assert not accepts(registry, lambda: registry.publish(replace(draft_manifest(), name=text), b"fine", "card"))
    assert not accepts(registry, lambda: registry.sign(text, 2, b"x"))


@pytest.mark.parametrize("ugly", TEXTS)
def test_the_name_of_a_user_never_breaks_a_history(
    registry: Registry, ugly: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The environment names the user, and a history keeps that name only if it can be read back."""
    if "\x00" not in TEXTS[ugly]:  # no variable can hold it
        monkeypatch.setenv("LOGNAME", TEXTS[ugly].replace("\ud800", "\udc80"))
    assert accepts(registry, lambda: registry.point_alias(NAME, "champion", 2))


@pytest.mark.parametrize("number", [0, -1, 10**9, 2**63, 10**400])
def test_a_number_that_no_reader_takes_for_a_version_is_refused(registry: Registry, number: int) -> None:
    """A version has 1 to 9 digits, in folders, states, manifests and references alike."""
    assert not accepts(registry, lambda: registry.point_alias(NAME, "champion", number))
    assert not accepts(registry, lambda: registry.remove(NAME, number))
    assert not accepts(registry, lambda: registry.copy(registry, NAME, number))


def test_the_version_after_the_last_number_is_refused(registry: Registry) -> None:
    """The number behind the last one that can be read is not given."""
    (registry.root / NAME / "removed" / "999999999").mkdir(parents=True)
    registry.point_alias(NAME, "champion", 2)  # records the number
    assert not accepts(registry, lambda: registry.publish(draft_manifest(), b"fine", "card"))


def test_a_signature_that_is_too_long_to_be_read_is_not_stored(registry: Registry) -> None:
    """The limit of the reader is that of the writer."""
    assert accepts(registry, lambda: registry.sign(NAME, 1, b"x" * MAX_SIGNATURE_BYTES))
    assert not accepts(registry, lambda: registry.sign(NAME, 1, b"x" * (MAX_SIGNATURE_BYTES + 1)))


@pytest.mark.parametrize("ugly", TEXTS)
def test_a_key_with_an_ugly_name_is_refused_or_admitted(ugly: str) -> None:
    """The line of a key is refused before it is printed, or the file that holds it admits the key."""
    try:
        grant, _ = Grant.new(TEXTS[ugly], frozenset({Scope.PREDICT}))
    except CazslError:
        return
    pytest.fail(f"accepted {grant.line()!r}")


def test_a_state_that_is_too_large_to_be_read_is_not_written() -> None:
    """The state of a model in a bucket is not replaced by one that the next reader refuses."""
    event = Event("publish", None, 1).stamped("me", "").render()
    whole = StateFile(ModelState(frozenset(range(1, 1000)), {"champion": 1}), 5, event)
    assert StateFile.parse(whole.render()) == whole
    for state in (
        ModelState(frozenset(range(1, 1_000_000))),
        ModelState(frozenset({1}), {f"a{place}": 1 for place in range(20_000)}),
        ModelState(frozenset({10**9})),
        ModelState(frozenset({1}), {"A B": 1}),
    ):
        with pytest.raises(CazslError):
            StateFile(state, 5, event).render()


@pytest.mark.parametrize("kind", ["text", "number"])
def test_a_manifest_of_format_1_that_is_read_can_be_shown_and_copied(registry: Registry, kind: str) -> None:
    """Format 1 has no digest of its own, so it can be edited. A reader accepts only edits that a writer would make."""
    path = registry.root / NAME / "1" / "manifest.json"
    files = {MODEL_FILE: FileDigest.of(b"fine"), CARD_FILE: FileDigest.of(f"# {NAME}\n".encode())}
    plain = json.loads(replace(draft_manifest(), format=1, files=files).render())
    ugly = TEXTS if kind == "text" else NUMBERS
    kinds: tuple[type, ...] = (str,) if kind == "text" else (int, float)
    documents = [document for value in ugly.values() for document in changed(plain, value, kinds)]
    contents = [json.dumps(document, ensure_ascii=True).encode() for document in documents]
    contents += [content.replace(b"Infinity", b"1e999") for content in contents if b"Infinity" in content]
    read = 0
    for content in contents:
        try:
            Manifest.parse(content)
        except CazslError:
            continue
        path.write_bytes(content)
        try:
            version = registry.read(NAME, 1)
        except CazslError:
            continue
        read += 1
        document = pydantic_core.from_json(version.manifest.render(), allow_inf_nan=False)
        assert orjson.loads(orjson.dumps(document)) == document
        if read % 10 == 0:
            assert Registry(registry.root.parent / f"copy-{read}").copy(registry, NAME, 1) == version
            assert accepts(registry, partial(registry.publish, version.manifest, b"fine", "card"))
    assert 20 < read < len(contents)
