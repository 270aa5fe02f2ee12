"""Shares rasters within a process: who opens the same files in the same way gets the same terrain, while it is in use.

An offline replay runs all nodes of a site in one process, and each of them opens the DEM: of 10,000 x 10,000 cells it
would otherwise hold 400 MB a node.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from weakref import WeakValueDictionary

from ltm_core.raster.dem import Dem

_open: WeakValueDictionary[Hashable, Dem] = WeakValueDictionary()
_lock = threading.Lock()


def shared(paths: Iterable[Path | str], way: Hashable, read: Callable[[], Dem]) -> Dem:
    """What `read` makes of the files at `paths`, or what it made of them before, if somebody still holds that and no
    file has changed.

    `way`: all else that the result depends on. Nobody may write to a terrain that is shared. Errors
    are those of `read`.
    """
    with _lock:
        try:
            key: Hashable = (way, *(_state(path) for path in paths))
        except OSError:
            return read()  # which says what is wrong with the file
        dem = _open.get(key)
        if dem is None:
            dem = _open[key] = read()
        return dem


def _state(path: Path | str) -> tuple[str, int, int, int]:
    found = Path(path).stat()
    return str(Path(path).resolve()), found.st_ino, found.st_size, found.st_mtime_ns
