"""A server that sends given bytes, one part at a time, to test clients against invalid answers."""

import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from tests.running_service import PATIENCE_S

Reply = Sequence[bytes]
"""Parts that are sent one by one with a pause between them. An empty sequence closes the connection at once."""
BETWEEN_PARTS_S = 0.05


@dataclass
class Received:
    """Heads of the received requests."""

    heads: list[str] = field(default_factory=list)


def reply(status: str, content: bytes, *headers: str) -> list[bytes]:
    """Build a whole answer as one part."""
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(content)}", "Connection: close", *headers]
    return ["\r\n".join(lines).encode() + b"\r\n\r\n" + content]


@contextmanager
def hostile(replies: Sequence[Reply]) -> Iterator[tuple[str, Received]]:
    """Run a server that sends these replies and repeats the last one. Yield its address and the received requests."""
    received, done = Received(), threading.Event()
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
                _answer(connection, replies[min(len(received.heads), len(replies) - 1)], received, done)

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}", received
        finally:
            done.set()
            socket.create_connection(listener.getsockname()).close()  # wakes the thread
            thread.join()


def _answer(connection: socket.socket, parts: Reply, received: Received, done: threading.Event) -> None:
    with connection:
        connection.settimeout(PATIENCE_S)
        request = b""
        while b"\r\n\r\n" not in request:
            part = connection.recv(65536)
            if not part:
                return  # the client closed the connection without a request
            request += part
        received.heads.append(request.partition(b"\r\n\r\n")[0].decode())
        try:
            for part in parts:
                connection.sendall(part)
                if len(parts) > 1 and done.wait(BETWEEN_PARTS_S):
                    return
            connection.shutdown(socket.SHUT_WR)
            while connection.recv(65536):
                pass  # reads the rest of the request, because closing earlier would reset the connection
        except OSError:
            return  # the client closed the connection
