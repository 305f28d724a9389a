"""The writer of the log never makes a caller wait, and counts each line that it loses."""

import errno
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import TextIO

import pytest

from service.observability.log_writer import FAILED, FULL, LogWriter

LINE = b'{"n": %d}\n'


class Failing(StringIO):
    """A stream that fails with an error until a test repairs it."""

    error: BaseException | None = None

    def write(self, text: str) -> int:
        """Write, or raise the error."""
        if self.error is not None:
            raise self.error
        return super().write(text)


@pytest.fixture
def pipe() -> Iterator[tuple[int, TextIO]]:
    """Return a pipe: the descriptor of its reader, and a stream that writes to it."""
    reader, writer = os.pipe()
    with os.fdopen(writer, "w", encoding="utf-8") as stream:
        yield reader, stream
    os.close(reader)


def numbers(text: str) -> list[int | str]:
    """Return the number of each line, or its message."""
    lines = [json.loads(line) for line in text.splitlines()]
    return [line["n"] if "n" in line else line["message"] for line in lines]


def read_all(reader: int, stream: TextIO) -> str:
    """Close the stream and return all that was written."""
    stream.close()
    with os.fdopen(os.dup(reader), encoding="utf-8") as found:
        return found.read()


def test_a_pipe_that_is_not_read_delays_no_caller(pipe: tuple[int, TextIO]) -> None:
    """Lines wait up to the limit, and then are dropped. Once the pipe is read, a line says how many, in its place."""
    reader, stream = pipe
    writer = LogWriter(stream, queue_bytes=100_000)
    for number in range(30_000):
        writer.put(LINE % number)
    assert writer.dropped[FULL] > 10_000
    written, is_queued = b"", False
    while b"30000" not in written:
        written += os.read(reader, 65536)
        if not is_queued:  # it fits again once some lines are written
            dropped = writer.dropped[FULL]
            writer.put(LINE % 30_000)
            is_queued = writer.dropped[FULL] == dropped
    writer.close(30)
    found = numbers(written.decode() + read_all(reader, stream))
    expected = reported = 0
    for line in found[: found.index(30_000)]:
        if isinstance(line, int):
            assert line == expected  # in order, and none is missing that was not reported before
            expected += 1
        else:
            reported += int(line.removesuffix(" lines dropped"))
            expected += int(line.removesuffix(" lines dropped"))
    assert expected >= 30_000  # more if the last line was dropped at first
    assert reported == writer.dropped[FULL]


def test_lines_that_are_dropped_last_are_reported_without_another_line(pipe: tuple[int, TextIO]) -> None:
    """The count of missing lines does not wait for the next line."""
    reader, stream = pipe
    writer = LogWriter(stream, queue_bytes=200_000)
    writer.put(b'"%s"\n' % (b"x" * 150_000))  # more than the pipe holds
    writer.put(b'"%s"\n' % (b"x" * 150_000), count=7)
    written = b""
    while b"7 lines dropped" not in written:
        written += os.read(reader, 65536)
    writer.close()


@pytest.mark.parametrize(
    "error",
    [
        BrokenPipeError(errno.EPIPE, ""),
        OSError(errno.ENOSPC, ""),
        OSError(errno.EBADF, ""),
        ValueError("closed file"),
        SystemExit(),
    ],
    ids=repr,
)
def test_a_stream_that_fails_costs_lines_and_raises_in_no_caller(error: BaseException) -> None:
    """Lost lines are counted and reported once the stream works again, and the health shows the failure until then."""
    stream = Failing()
    writer = LogWriter(stream)
    writer.put(LINE % 1)
    writer.flush(30)
    stream.error = error
    writer.put(LINE % 2 + LINE % 3, count=2)
    writer.put(LINE % 4)
    writer.flush(30)
    assert writer.dropped[FAILED] == 3
    assert (writer.health.error, writer.health.failures) == (type(error).__name__, 2)
    assert writer.health.age_s() > 0.0
    stream.error = None
    writer.put(LINE % 5)
    writer.close(30)
    assert numbers(stream.getvalue()) == [1, "3 lines dropped", 5]
    assert (writer.health.error, writer.health.age_s()) == (None, 0.0)


@pytest.mark.parametrize("target", ["/dev/full", "closed"])
def test_a_full_disk_and_a_closed_descriptor_cost_lines_only(target: str, tmp_path: Path) -> None:
    """A real full disk, and a descriptor that another part of the process has closed."""
    path = Path("/dev/full") if target == "/dev/full" else tmp_path / "log"
    with path.open("w", encoding="utf-8") as stream:
        if target == "closed":
            os.close(stream.fileno())
        writer = LogWriter(stream)
        writer.put(LINE % 1)
        writer.close(30)
        assert writer.dropped[FAILED] == 1
        if target == "closed":  # the stream must not close a descriptor that is not its own
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def test_without_standard_error_lines_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python has no standard error if it was closed before the start."""
    monkeypatch.setattr(sys, "stderr", None)
    writer = LogWriter()
    writer.put(LINE % 1)
    writer.close(30)
    assert writer.dropped[FAILED] == 1


def test_a_pipe_that_does_not_block_loses_no_line(pipe: tuple[int, TextIO]) -> None:
    """Another process that has the pipe may have made it non-blocking. Then the writer waits until it has room."""
    reader, stream = pipe
    os.set_blocking(stream.fileno(), False)
    writer = LogWriter(stream)
    text = b"".join(LINE % number for number in range(20_000))
    writer.put(text, count=20_000)
    written = b""
    while len(written) < len(text):
        written += os.read(reader, 65536)
    writer.close(30)
    assert written == text


def test_the_end_does_not_await_a_pipe_that_is_not_read(pipe: tuple[int, TextIO]) -> None:
    """Flushing is bounded in time, although the thread of the writer hangs."""
    _, stream = pipe
    writer = LogWriter(stream)
    writer.put(b"x" * 200_000)
    writer.close(0.01)
    assert writer.health.age_s() > 0.0


def test_lines_of_many_threads_are_whole_and_in_order() -> None:
    """Each thread finds its lines in their order."""
    stream = StringIO()
    writer = LogWriter(stream)

    def write(thread: int) -> None:
        """Write the lines of a thread."""
        for number in range(200):
            writer.put(b"[%d, %d]\n" % (thread, number))

    threads = [threading.Thread(target=write, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    writer.close(30)
    found = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert len(found) == 1600
    for number in range(8):
        assert [line[1] for line in found if line[0] == number] == list(range(200))


def test_a_line_that_was_torn_does_not_spoil_the_next(tmp_path: Path) -> None:
    """After half a line was written, the next one begins on a new line."""
    code = f"""
import resource, signal
from service.observability.log_writer import LogWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20, resource.RLIM_INFINITY))  # a disk with room for 20 bytes
writer = LogWriter(open({str(tmp_path / "log")!r}, "w"))
writer.put(b'{{"n": 1}}\\n')
writer.put(b'{{"n": "longer than the room"}}\\n')
writer.flush(30)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
writer.put(b'{{"n": 3}}\\n')
writer.close(30)
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    lines = (tmp_path / "log").read_text().splitlines()
    assert lines[0] == '{"n": 1}'
    assert lines[1] == '{"n": "longer than the room"}'[:11]
    assert numbers("\n".join(lines[2:])) == ["1 lines dropped", 3]
