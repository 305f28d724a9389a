"""Tests of histories: a changed line breaks the chain."""

import hashlib
import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import BrokenModelError
from service.storage.history import (
    CHAINED_SINCE,
    MAX_LINES,
    MAX_PROBLEMS,
    NO_HEAD,
    PUBLISH,
    REMOVE,
    UNRECORDED,
    Event,
    Head,
    History,
    ModelState,
    unrecorded,
)

START = datetime(2026, 11, 1, tzinfo=UTC)
EVENTS = (
    Event(PUBLISH, None, 1, manifest="0" * 64),
    Event.alias_move("champion", None, 1),
    Event(PUBLISH, None, 2),
    Event.alias_move("champion", 1, 2, "better"),
    Event(REMOVE, 1, None, reason="old"),
)
BEFORE_CHAINS = b'{"time": "2026-10-01T00:00:00+00:00", "who": "a", "what": "publish", "from": null, "to": 1}\n'


def chain(events: tuple[Event, ...] = EVENTS, content: bytes = b"", start: datetime = START) -> bytes:
    """Render a history of these events, one per day."""
    for day, event in enumerate(events):
        content += event.stamped("ann", History.parse(content).head, start + timedelta(days=day)).render()
    return content


def test_a_history_is_read_as_it_was_written() -> None:
    """A parsed history has every field that was written, an unbroken chain, and the resulting state."""
    history = History.parse(chain())
    assert history.problems == ()
    assert [(event.what, event.before, event.to) for event in history.events] == [
        (event.what, event.before, event.to) for event in EVENTS
    ]
    assert (history.events[3].reason, history.events[0].manifest, history.events[0].who) == ("better", "0" * 64, "ann")
    assert history.state() == ModelState(frozenset({2}), {"champion": 2}, frozenset({1}))


@pytest.mark.parametrize(("day", "version"), [(-1, None), (0, None), (1, 1), (2.5, 1), (3, 2), (99, 2)])
def test_state_at_an_instant_includes_earlier_events(day: float, version: int | None) -> None:
    """The state at an instant includes every event up to and including its second."""
    assert History.parse(chain()).state(START + timedelta(days=day)).aliases.get("champion") == version


@pytest.mark.parametrize("line", range(len(EVENTS)))
def test_any_flipped_bit_breaks_the_chain_at_its_line_or_the_next(line: int) -> None:
    """A flipped bit breaks the chain at its own line or at the next one.

    The last line is covered once another line follows it.
    """
    lines = chain().splitlines(keepends=True)
    for place in range(len(lines[line]) - 1):
        for bit in range(8):
            flipped = lines[line][:place] + bytes([lines[line][place] ^ 1 << bit]) + lines[line][place + 1 :]
            changed = b"".join([*lines[:line], flipped, *lines[line + 1 :]])
            follow_up = changed + Event(PUBLISH, None, 3).stamped("x", History.parse(chain()).head).render()
            assert History.parse(follow_up).problems


def test_removed_or_inserted_line_breaks_the_chain() -> None:
    """A chain breaks if lines are removed, inserted or exchanged."""
    lines = chain().splitlines(keepends=True)
    for changed in (lines[:1] + lines[2:], lines[:2] + lines[1:], [lines[1], lines[0], *lines[2:]]):
        assert "chain breaks" in " ".join(History.parse(b"".join(changed)).problems)


def test_history_without_a_chain_continues_as_one() -> None:
    """The first line with a digest covers all lines before it, so an old history continues as a chain."""
    old = BEFORE_CHAINS * 3
    assert History.parse(old).problems == ()
    whole = chain(EVENTS[1:], old)
    assert History.parse(whole).problems == ()
    assert History.parse(whole.replace(b'"who": "a"', b'"who": "b"', 1)).problems
    assert History.parse(whole + BEFORE_CHAINS).problems, "a line without a digest cannot follow a chain"


@pytest.mark.parametrize("stripped", [range(len(EVENTS)), range(1), range(1, len(EVENTS)), range(2, 3)])
@pytest.mark.parametrize("follow_up", [False, True])
def test_history_is_not_stripped_of_its_chain(stripped: range, follow_up: bool) -> None:
    """A line without a link is accepted only from before chains existed, also if a change follows it."""
    documents = [json.loads(line) for line in chain(start=CHAINED_SINCE).splitlines()]
    for number in stripped:
        del documents[number]["previous"]
    content = b"".join(json.dumps(document).encode() + b"\n" for document in documents)
    if follow_up:
        content += Event(PUBLISH, None, 3).stamped("x", History.parse(content).head).render()
    assert History.parse(content).problems


def test_history_of_a_time_that_is_no_time_is_not_older_than_chains() -> None:
    """A line whose time cannot be read is not taken for an old one."""
    line = BEFORE_CHAINS.replace(b"2026-10-01T00:00:00+00:00", b"long ago")
    assert "the chain was taken out" in History.parse(line).problems[0]


def test_history_is_not_cut_at_its_end() -> None:
    """A history that lacks lines of its recorded end has a problem. Later lines are no problem."""
    lines = chain().splitlines(keepends=True)
    for length in range(1, len(lines) + 1):
        head = Head(length, hashlib.sha256(lines[length - 1]).hexdigest())
        assert Head.parse(head.render()) == head
        for kept in range(len(lines) + 1):
            found = History.parse(b"".join(lines[:kept]), head)
            assert (found.cut is None) == (kept >= length)
            assert (found.cut in found.problems) == (kept < length)
        changed = [*lines[: length - 1], lines[length - 1].replace(b"ann", b"bob"), *lines[length:]]
        assert History.parse(b"".join(changed), head).cut is not None


def test_history_with_numbers_has_a_recorded_end() -> None:
    """A history whose lines are numbered has a recorded end. Without it, lines may have been cut off.

    The end is recorded after the line, so a writer at work, or one that was killed, leaves the first line without it.
    """
    line = Event(PUBLISH, None, 1).stamped("ann", History().head, START, number=1).render()
    second = Event(PUBLISH, None, 2).stamped("ann", History.parse(line).head, START, number=2).render()
    assert History.parse(line).problems == ()
    assert History.parse(line + second).cut is not None
    assert History.parse(line, NO_HEAD).cut is not None
    assert History.parse(line, Head(1, hashlib.sha256(line).hexdigest())).problems == ()


@pytest.mark.parametrize("content", [b"", b"1", b"1 x\n", b"-1 " + b"0" * 64 + b"\n", b"1 " + b"0" * 64 + b"\n\n"])
def test_other_content_is_no_head(content: bytes) -> None:
    """A head is a number and a digest in one line."""
    assert Head.parse(content) is None


def test_absence_is_recorded_and_is_no_intent() -> None:
    """A version or an alias that was only found missing is still asked for, until a writer removes it."""
    absent = (Event("vanish", 2, None), replace(Event.alias_move("champion", 2, None), reason=UNRECORDED))
    history = History.parse(chain((*EVENTS[:4], *absent)))
    assert history.state() == ModelState(frozenset({1}), {}, frozenset({2}))
    assert history.intended() == ModelState(frozenset({1, 2}), {"champion": 2})
    assert history.lost(ModelState(frozenset({1}))) == ModelState(frozenset({2}), {"champion": 2})
    assert not history.gave_up("champion")
    dropped = History.parse(chain((*EVENTS[:4], Event.alias_move("champion", 2, None, "old"))))
    assert dropped.gave_up("champion")
    assert not dropped.gave_up("canary")


@pytest.mark.parametrize(
    "line",
    [
        b'{"time": "", "who": "", "what": "publish", "to": 1, "to": 2}',
        b'{"time": "", "who": "", "what": "publish", "to": 1e999}',
        b'{"time": "", "who": "", "what": "publish", "to": 1.5}',
        b'{"time": "", "who": "", "what": "publish", "to": true}',
        b'{"time": "", "who": "", "what": "publish", "to": -1}',
        b'{"time": "", "who": "", "what": "publish", "to": NaN}',
        b'{"time": "", "who": "", "what": ["publish"], "to": 1}',
        b'{"time": "", "who": "\\ud800", "what": "publish", "to": 1}',
        b'{"time": "", "who": "\xff", "what": "publish", "to": 1}',
        b'{"who": "", "what": "publish", "to": 1}',
        b"[" * 100_000,
        b'"publish"',
    ],
)
def test_line_that_is_not_strict_json_is_no_event(line: bytes) -> None:
    """A line is read by the strict reader of registries, and one that it refuses is a problem."""
    assert History.parse(line + b"\n").problems[0] == "line 1 is not an event"


def test_torn_last_line_is_reported_and_the_others_are_kept() -> None:
    """A last line that is cut at any byte is reported, and all other events are kept."""
    content = chain()
    for cut in range(1, len(content.splitlines()[-1]) + 1):
        history = History.parse(content[:-cut])
        assert len(history.events) == len(EVENTS) - 1
        assert history.problems[-1:] == () if history.torn_bytes == 0 else "torn" in history.problems[-1]


def test_many_faults_are_counted_and_too_many_lines_are_refused() -> None:
    """A file of short lines costs bounded time and memory: its first faults are listed, and too many lines refused."""
    problems = History.parse(b"\n" * (MAX_PROBLEMS + 5)).problems
    assert len(problems) == MAX_PROBLEMS + 1
    assert problems[-1] == "5 more faults"
    with pytest.raises(BrokenModelError, match=f"more than {MAX_LINES} lines"):
        History.parse(b"\n" * (MAX_LINES + 1))


@given(st.binary(max_size=200))
def test_arbitrary_bytes_are_parsed_without_an_exception(content: bytes) -> None:
    """Any bytes give events or reported problems, and never an exception."""
    history = History.parse(content)
    assert history.events or history.problems or not content


@given(
    st.frozensets(st.integers(1, 5)),
    st.frozensets(st.integers(1, 5)),
    st.dictionaries(st.sampled_from("ab"), st.integers(1, 5)),
)
def test_unrecorded_events_lead_from_the_recorded_to_the_actual_state(
    recorded: frozenset[int], versions: frozenset[int], aliases: dict[str, int]
) -> None:
    """Applying the unrecorded events to the recorded state gives the actual state."""
    before = ModelState(recorded, {"a": 1})
    actual = ModelState(versions, aliases, recorded - versions)
    state = before
    for event in unrecorded(before, actual):
        assert event.reason == UNRECORDED
        state = state.after(event)
    assert (state.versions, dict(state.aliases)) == (actual.versions, dict(actual.aliases))
    assert not unrecorded(state, actual)


def test_each_line_is_one_json_object() -> None:
    """A line is one JSON object with the documented keys."""
    for line in chain().splitlines():
        assert {"time", "who", "what", "from", "to", "previous"} <= set(json.loads(line))
