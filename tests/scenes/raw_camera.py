"""A camera that answers each request with the next of some byte strings, whatever is asked; the last one to all others.

For answers that `http.server` cannot give: each is sent as it is.
"""

import contextlib
import re
import socket
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

Answer = bytes | Callable[[str], bytes | Iterable[bytes]]
"""Bytes, or what makes them from the head of the request, maybe piece by piece."""


@dataclass
class RawCamera:
    port: int = 0
    heads: list[str] = field(default_factory=list)
    """Heads of the requests."""
    keep: bool = False
    """Whether connections stay open after an answer."""

    def url(self, path: str = "/picture", scheme: str = "http") -> str:
        return f"{scheme}://127.0.0.1:{self.port}{path}"


@contextlib.contextmanager
def raw_camera(*answers: Answer, keep: bool = False) -> Iterator[RawCamera]:
    listener = socket.create_server(("127.0.0.1", 0))
    camera, left = RawCamera(listener.getsockname()[1], keep=keep), list(answers)

    def serve(connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection:
            connection.settimeout(5.0)
            buffer = b""
            while True:
                while b"\r\n\r\n" not in buffer:
                    if not (part := connection.recv(65536)):
                        return
                    buffer += part
                head, _, buffer = buffer.partition(b"\r\n\r\n")
                if (length := re.search(rb"(?i)content-length: *(\d+)", head)) is not None:
                    while len(buffer) < int(length[1]):
                        buffer += connection.recv(65536)
                    buffer = buffer[int(length[1]) :]
                camera.heads.append(head.decode("latin-1"))
                answer = left.pop(0) if len(left) > 1 else left[0]
                sent = answer if isinstance(answer, bytes) else answer(camera.heads[-1])
                for part in [sent] if isinstance(sent, bytes) else sent:
                    connection.sendall(part)
                if not keep:
                    return

    def listen() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                threading.Thread(target=serve, args=(connection,), daemon=True).start()

    threading.Thread(target=listen, daemon=True).start()
    try:
        yield camera
    finally:
        listener.close()
