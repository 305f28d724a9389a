"""Connections are bounded in number, and the right one makes room."""

import resource

import pytest

from service.connections.open_connections import OTHER_DESCRIPTORS, OpenConnections, affordable, raise_descriptors


class FakeGuest:
    """A connection in a state that a test sets."""

    def __init__(self, caller: str, state: str = "idle", waited: float = 0.0) -> None:
        self.caller = caller
        self.state = state
        self.waited = waited

    def is_idle(self) -> bool:
        """Return True in this state."""
        return self.state == "idle"

    def is_busy(self) -> bool:
        """Return True in this state."""
        return self.state == "busy"

    def waited_s(self) -> float:
        """Return the time that the test set."""
        return self.waited

    def make_room(self) -> None:
        """Note it."""
        self.state = "left"

    def turn_away(self) -> None:
        """Note it."""
        self.state = "turned away"


@pytest.mark.parametrize(
    ("states", "newcomer", "leaver"),
    [
        ([("a", "idle", 1.0), ("a", "idle", 9.0), ("a", "reading", 99.0)], "a", 1),
        ([("a", "idle", 99.0), ("b", "idle", 1.0), ("b", "idle", 2.0)], "c", 2),
        ([("a", "busy", 0.0), ("a", "reading", 5.0), ("a", "reading", 7.0)], "b", 2),
        ([("a", "busy", 0.0), ("a", "busy", 0.0), ("a", "busy", 0.0)], "b", None),
        ([("a", "reading", 1.0), ("b", "reading", 2.0), ("c", "reading", 3.0)], "d", None),
        ([("a", "reading", 1.0), ("a", "reading", 2.0), ("a", "reading", 3.0)], "a", None),
    ],
    ids=[
        "the longest idle one",
        "one of the caller with the most",
        "a slow one of a caller with many",
        "none, since all are being answered",
        "none, since no caller has many",
        "none of its own",
    ],
)
def test_the_right_connection_makes_room(
    states: list[tuple[str, str, float]], newcomer: str, leaver: int | None
) -> None:
    """An idle one leaves first. A busy one never does, and without one the newcomer is turned away."""
    found = OpenConnections(len(states))
    guests = [FakeGuest(*state) for state in states]
    for connection in guests:
        found.enter(connection)
    last = FakeGuest(newcomer, "new")
    found.enter(last)
    assert [connection.state == "left" for connection in guests] == [number == leaver for number in range(len(guests))]
    assert (last.state == "turned away") is (leaver is None)
    assert len(found) == len(guests)


def test_a_lost_connection_leaves_room() -> None:
    """A place is free again after its connection, and one that was turned away had none."""
    found = OpenConnections(1)
    first, second = FakeGuest("a", "busy"), FakeGuest("a", "busy")
    found.enter(first)
    found.enter(second)
    assert second.state == "turned away"
    found.leave(second)
    found.leave(first)
    assert len(found) == 0
    found.enter(FakeGuest("b"))
    assert len(found) == 1


def test_no_more_connections_than_file_descriptors(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit of descriptors is raised as far as the system allows, and bounds the connections beyond that."""
    limits = [200, 1000]
    monkeypatch.setattr(resource, "getrlimit", lambda _: tuple(limits))
    monkeypatch.setattr(resource, "setrlimit", lambda _, found: limits.__setitem__(slice(2), found))
    assert affordable(50) == 50
    assert affordable(500) == 200 - OTHER_DESCRIPTORS
    raise_descriptors(500)
    assert (limits, affordable(500)) == ([500 + OTHER_DESCRIPTORS, 1000], 500)
    raise_descriptors(5000)
    assert (limits, affordable(5000)) == ([1000, 1000], 1000 - OTHER_DESCRIPTORS)
    raise_descriptors(5)
    assert limits == [1000, 1000]
