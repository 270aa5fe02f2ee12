"""What each process keeps that is bounded, as a soak's report names it.

Nothing of it is subtracted from what grows: it is full before growth is taken, fills slowly, or comes and goes in
turns.
"""

from __future__ import annotations

from dataclasses import dataclass

from ltm_core.storage.tile_store_file import CACHE_KB
from ltm_core.vision.smoke import REMEMBERED as PICTURES
from ltm_core.vision.smoke import WORKING_WIDTH
from ltm_ros.nodes.recorder import RecorderConfig
from ltm_ros.runtime.stamp_join import REMEMBERED as STAMPS

STATED = "ltm_lab/records/2026-11-runtime.md, memory over months"
_FILE_MINUTES = RecorderConfig.model_fields["file_seconds"].default / 60
_STORE = f"{CACHE_KB} kB of a store's file: its first tiles, then 18 bytes a frame that is counted, for two hours here"
_PICTURE_KB = WORKING_WIDTH**2 * 9 / 16 * (1 + 1 / 8 + 4 / 16) / 1000


@dataclass(frozen=True)
class BoundedCache:
    """`label`: of the process. `said`: what it is, its bound, and when that is reached."""

    label: str
    said: str


CACHES = (
    BoundedCache("cameras", f"{PICTURES} pictures for smoke, {PICTURES * _PICTURE_KB:.0f} kB a camera, with the first"),
    BoundedCache("cameras", f"stamps, poses, calibrations of {STAMPS} frames a camera, full after as many"),
    BoundedCache("fuel_map", _STORE),
    BoundedCache("terrain", _STORE),
    BoundedCache("recorder", f"the index of the file at hand, which ends after {_FILE_MINUTES:.0f} minutes"),
)


def caches_of(label: str) -> list[str]:
    """In words, those of a process."""
    return [cache.said for cache in CACHES if cache.label == label]
