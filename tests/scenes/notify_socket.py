"""A service manager's socket, which hears what a service tells of itself."""

import socket
from pathlib import Path


class NotifySocket:
    """Listens on a Unix socket, in a folder or (`@name`) in the abstract namespace."""

    def __init__(self, address: str | Path) -> None:
        self.address = str(address)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(f"\0{self.address[1:]}" if self.address[0] == "@" else self.address)
        self._heard: list[tuple[str, str]] = []

    def __enter__(self) -> "NotifySocket":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    @property
    def heard(self) -> list[tuple[str, str]]:
        """All assignments so far, in order."""
        while True:
            try:
                message = self._socket.recv(1 << 16)
            except BlockingIOError:
                return self._heard
            for line in message.decode().splitlines():
                name, _, value = line.partition("=")
                self._heard.append((name, value))

    def of(self, name: str) -> list[str]:
        """The values that `name` was given."""
        return [value for heard, value in self.heard if heard == name]
