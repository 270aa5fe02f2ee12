"""A disk that is full at will: SQLite is told to let its files grow no more, and fails as on a full one."""

import contextlib
import sqlite3
from typing import Any

import pytest


class SmallDisk:
    """All files that SQLite opens from now on, until the test ends, are on it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._connections: list[sqlite3.Connection] = []
        self._connect = sqlite3.connect
        monkeypatch.setattr(sqlite3, "connect", self._remembered)

    def _remembered(self, *arguments: Any, **options: Any) -> sqlite3.Connection:
        # The limit is a connection's, not a file's: it must be set on the one that writes.
        connection = self._connect(*arguments, **options)
        self._connections.append(connection)
        return connection

    def fill(self, spare_pages: int = 0) -> None:
        """From now on each file grows by `spare_pages` at most."""
        for connection in self._connections:
            with contextlib.suppress(sqlite3.ProgrammingError):  # closed
                (pages,) = connection.execute("PRAGMA page_count").fetchone()
                connection.execute(f"PRAGMA max_page_count = {pages + spare_pages}")

    def free(self) -> None:
        for connection in self._connections:
            with contextlib.suppress(sqlite3.ProgrammingError):
                connection.execute("PRAGMA max_page_count = 1000000")
