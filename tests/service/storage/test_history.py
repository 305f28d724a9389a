"""The chain of what happened: nothing can be changed in it unseen."""

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
    """A history of these events, a day each."""
    for day, event in enumerate(events):
        content += event.signed_off("ann", History.parse(content).head, START + timedelta(days=day)).render()
    return content


def test_a_history_is_read_as_it_was_written() -> None:
    """Every field comes back, the chain holds, the state follows."""
    history = History.parse(chain())
    assert history.problems == ()
    assert [(event.what, event.before, event.to) for event in history.events] == [
        (event.what, event.before, event.to) for event in EVENTS
    ]
    assert (history.events[3].reason, history.events[0].manifest, history.events[0].who) == ("better", "0" * 64, "ann")
    assert history.state() == ModelState(frozenset({2}), {"champion": 2}, frozenset({1}))


@pytest.mark.parametrize(("day", "version"), [(-1, None), (0, None), (1, 1), (2.5, 1), (3, 2), (99, 2)])
def test_what_an_alias_named_on_a_day_can_be_told(day: float, version: int | None) -> None:
    """Events count from their own second on."""
    assert History.parse(chain()).state(START + timedelta(days=day)).aliases.get("champion") == version


@pytest.mark.parametrize("line", range(len(EVENTS)))
def test_any_flipped_bit_breaks_the_chain_at_its_line_or_the_next(line: int) -> None:
    """What was written cannot be changed unseen, but for the last line, which nothing vouches for yet."""
    lines = chain().splitlines(keepends=True)
    for place in range(len(lines[line]) - 1):
        for bit in range(8):
            flipped = lines[line][:place] + bytes([lines[line][place] ^ 1 << bit]) + lines[line][place + 1 :]
            changed = b"".join([*lines[:line], flipped, *lines[line + 1 :]])
            follow_up = changed + Event(PUBLISH, None, 3).signed_off("x", History.parse(chain()).head).render()
            assert History.parse(follow_up).problems


def test_a_line_taken_out_or_put_in_breaks_the_chain() -> None:
    """Removal, insertion and exchange of lines."""
    lines = chain().splitlines(keepends=True)
    for changed in (lines[:1] + lines[2:], lines[:2] + lines[1:], [lines[1], lines[0], *lines[2:]]):
        assert "chain breaks" in " ".join(History.parse(b"".join(changed)).problems)


def test_a_history_from_before_there_were_chains_goes_on_as_one() -> None:
    """The first chained line vouches for all that stands before it."""
    old = BEFORE_CHAINS * 3
    assert History.parse(old).problems == ()
    whole = chain(EVENTS[1:], old)
    assert History.parse(whole).problems == ()
    assert History.parse(whole.replace(b'"who": "a"', b'"who": "b"', 1)).problems
    assert History.parse(whole + BEFORE_CHAINS).problems, "a line without a link cannot follow a chain"


def test_a_torn_last_line_is_told_and_hurts_nothing_else() -> None:
    """What a crash in the middle of a write leaves."""
    content = chain()
    for cut in range(1, len(content.splitlines()[-1]) + 1):
        history = History.parse(content[:-cut])
        assert len(history.events) == len(EVENTS) - 1
        assert history.problems[-1:] == () if history.torn_bytes == 0 else "torn" in history.problems[-1]


@given(st.binary(max_size=200))
def test_any_bytes_are_a_history_with_its_problems(content: bytes) -> None:
    """No bytes do anything but be reported."""
    history = History.parse(content)
    assert history.events or history.problems or not content


@given(
    st.frozensets(st.integers(1, 5)),
    st.frozensets(st.integers(1, 5)),
    st.dictionaries(st.sampled_from("ab"), st.integers(1, 5)),
)
def test_what_was_not_recorded_leads_from_what_was_to_what_is(
    recorded: frozenset[int], versions: frozenset[int], aliases: dict[str, int]
) -> None:
    """Applying the differences gives the state that is there."""
    before = ModelState(recorded, {"a": 1})
    actual = ModelState(versions, aliases, recorded - versions)
    state = before
    for event in unrecorded(before, actual):
        assert event.reason == UNRECORDED
        state = state.after(event)
    assert (state.versions, dict(state.aliases)) == (actual.versions, dict(actual.aliases))
    assert not unrecorded(state, actual)


def test_lines_are_json_that_other_tools_can_read() -> None:
    """One object per line, with the keys of the contract."""
    for line in chain().splitlines():
        assert {"time", "who", "what", "from", "to", "previous"} <= set(json.loads(line))
