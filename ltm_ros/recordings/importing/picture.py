"""One photo to be imported, whatever file it lies in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.recordings.importing.photo import Photo


@dataclass(frozen=True)
class ImportedImage:
    """`name`: what a pose file calls it. `path`: of its file, or of what it lies in and its name there. `read`: the
    photo, each time anew: a season's photos do not fit in memory. `capture`: what a pose file calls all that was taken
    with it in one go, where this tells of its begin; empty: nothing."""

    name: str
    path: Path
    read: Callable[[], Photo]
    capture: str = ""
