"""A server that answers as it was told, byte by byte if need be: what a client must survive."""

import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from tests.serving import PATIENCE_S

Reply = Sequence[bytes]
"""Parts that are sent one by one, each after the client's wait for it could have ended; empty: hang up at once."""
BETWEEN_PARTS_S = 0.05


@dataclass
class Seen:
    """The heads of the requests that came."""

    heads: list[str] = field(default_factory=list)


def reply(status: str, content: bytes, *headers: str) -> list[bytes]:
    """A whole answer, as one part."""
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(content)}", "Connection: close", *headers]
    return ["\r\n".join(lines).encode() + b"\r\n\r\n" + content]


@contextmanager
def hostile(replies: Sequence[Reply]) -> Iterator[tuple[str, Seen]]:
    """A server that gives these replies, the last one over and over; its address, and what it saw."""
    seen, done = Seen(), threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(PATIENCE_S)

        def answer() -> None:
            while True:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return
                if done.is_set():
                    connection.close()
                    return
                _answer(connection, replies[min(len(seen.heads), len(replies) - 1)], seen, done)

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}", seen
        finally:
            done.set()
            socket.create_connection(listener.getsockname()).close()  # wakes the thread
            thread.join()


def _answer(connection: socket.socket, parts: Reply, seen: Seen, done: threading.Event) -> None:
    with connection:
        connection.settimeout(PATIENCE_S)
        request = b""
        while b"\r\n\r\n" not in request:
            request += connection.recv(65536)
        seen.heads.append(request.partition(b"\r\n\r\n")[0].decode())
        try:
            for part in parts:
                connection.sendall(part)
                if len(parts) > 1 and done.wait(BETWEEN_PARTS_S):
                    return
            connection.shutdown(socket.SHUT_WR)
            while connection.recv(65536):  # what is still coming of the request, lest closing resets the connection
                pass
        except OSError:
            return  # the client had enough
