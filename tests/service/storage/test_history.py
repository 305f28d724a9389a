"""Tests of histories: a changed line breaks the chain."""

import json
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.storage.history import PUBLISH, REMOVE, UNRECORDED, Event, History, ModelState, unrecorded

START = datetime(2026, 11, 1, tzinfo=UTC)
EVENTS = (
    Event(PUBLISH, None, 1, manifest="0" * 64),
    Event.alias_move("champion", None, 1),
    Event(PUBLISH, None, 2),
    Event.alias_move("champion", 1, 2, "better"),
    Event(REMOVE, 1, None, reason="old"),
)
BEFORE_CHAINS = b'{"time": "2026-10-01T00:00:00+00:00", "who": "a", "what": "publish", "from": null, "to": 1}\n'


def chain(events: tuple[Event, ...] = EVENTS, content: bytes = b"") -> bytes:
    """Render a history of these events, one per day."""
    for day, event in enumerate(events):
        content += event.stamped("ann", History.parse(content).head, START + timedelta(days=day)).render()
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


def test_torn_last_line_is_reported_and_the_others_are_kept() -> None:
    """A last line that is cut at any byte is reported, and all other events are kept."""
    content = chain()
    for cut in range(1, len(content.splitlines()[-1]) + 1):
        history = History.parse(content[:-cut])
        assert len(history.events) == len(EVENTS) - 1
        assert history.problems[-1:] == () if history.torn_bytes == 0 else "torn" in history.problems[-1]


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
