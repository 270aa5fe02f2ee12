"""Write the logs of a run: its folder, and one bounded file for each node."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

KEPT_RUNS = 10
"""Number of earlier log folders that `new_log_folder` keeps."""


def new_log_folder(site: str) -> Path:
    """Create a folder for a run's logs under `$XDG_STATE_HOME/ltm`, and remove all but the newest earlier ones. On a
    full disk, return a folder that does not exist yet."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state") / "ltm" / site
    begun = time.strftime("%Y%m%d-%H%M%S-")
    try:
        state.mkdir(parents=True, exist_ok=True)
        former = sorted(path for path in state.iterdir() if path.is_dir())
        for path in former[: max(0, len(former) - KEPT_RUNS + 1)]:
            shutil.rmtree(path, ignore_errors=True)
        return Path(tempfile.mkdtemp(prefix=begun, dir=state))
    except OSError:
        return state / f"{begun}{os.getpid()}"


LOG_BYTES = 4 << 20
LOG_FILES = 3


class NodeLog:
    """Appends time-stamped lines to `path`, which is rotated at `LOG_BYTES`; `LOG_FILES` files are kept.

    Calls `tell` once when lines cannot be written, and again with the number of lost lines when they can; raises
    nothing, unlike `logging`'s handler on a full disk.
    """

    def __init__(self, path: Path, tell: Callable[[str], None]) -> None:
        self._path, self._tell = path, tell
        self._file: io.FileIO | None = None
        self._missed = 0

    def write(self, line: str) -> None:
        """Write a line; call it from one thread at a time."""
        now = datetime.now().isoformat(" ", "milliseconds")
        try:
            self._append(f"{now} {line}\n".encode(errors="replace"))
        except OSError as error:
            self.close()
            self._missed += 1
            if self._missed == 1:
                self._tell(f"{self._path} cannot be written ({error.strerror}); free some disk space")
            return
        if self._missed:
            missed, self._missed = self._missed, 0
            self._tell(f"{self._path} can be written again; {missed} lines were lost")

    def close(self) -> None:
        """Close the file; the next line opens it again."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            self._file = None

    def _append(self, line: bytes) -> None:
        if self._file is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = io.FileIO(self._path, "a")
        if self._file.tell() + len(line) > LOG_BYTES:
            self._turn_over()
        if self._file.write(line) < len(line):
            raise OSError(None, "No space left on device")

    def _turn_over(self) -> None:
        assert self._file is not None  # nosec B101 # tells the type checker what holds
        self._file.close()
        for number in range(LOG_FILES - 1, 0, -1):
            former = self._path if number == 1 else self._numbered(number - 1)
            if former.exists():
                former.replace(self._numbered(number))
        self._file = io.FileIO(self._path, "a")

    def _numbered(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.name}.{number}")
