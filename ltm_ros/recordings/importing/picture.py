"""Describe one photo to import, whatever file contains it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.recordings.importing.photo import Photo


@dataclass(frozen=True)
class ImportedImage:
    """`name`: in a pose file. `path`: of its file, or of its container with its name there. `read`: reads the photo
    each time, because a season's photos do not fit in memory. `capture`: name in a pose file for all images of one
    capture, if its row gives the start; empty: none.
    """

    name: str
    path: Path
    read: Callable[[], Photo]
    capture: str = ""
