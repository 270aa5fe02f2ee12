"""Where a run's logs go."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from pathlib import Path

KEPT_RUNS = 10
"""Log folders of former runs that `new_log_folder` leaves."""


def new_log_folder(site: str) -> Path:
    """A fresh folder for a run's logs under `$XDG_STATE_HOME/ltm`; removes all but the newest former ones.

    On a full disk one that is not there yet: logs are made when there is room.
    """
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
