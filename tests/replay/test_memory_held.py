from __future__ import annotations

import gc
from pathlib import Path

import pytest
from chaos.cameras import CAMERAS, PHASES, Photos
from chaos.living_site import write_living_site
from scenes.small_site import NAME

from ltm_core.pipeline.site_surface import UNCOMMITTED
from ltm_ros.launching.graph import describe
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.process_memory import memory_in_use
from ltm_ros.runtime.stamp_join import REMEMBERED
from ltm_ros.runtime.topics import camera_topic

pytestmark = pytest.mark.slow

FRAMES = UNCOMMITTED // len(CAMERAS)
"""Of each camera, between the two counts: as many of them wait for the terrain's next commit then."""


def _held() -> tuple[int, int]:
    """Blocks of Python's allocator, and bytes of the C library's, that are in use."""
    gc.collect()
    in_use = memory_in_use()
    return in_use.python_blocks, in_use.heap_bytes or 0


def test_handlers_hold_no_more_after_more_frames(tmp_path: Path) -> None:
    """An object a frame that is kept by its stamp, in any of the twelve handlers, would show."""
    small = write_living_site(tmp_path)
    photos, offline = Photos(small), OfflineGraph(describe(small.site, small.path))
    stamp = 1_700_000_000_000_000_000

    def feed(first: int, count: int) -> None:
        nonlocal stamp
        for number in range(first, first + count):
            for camera in CAMERAS:
                stamp += 500_000_000
                for topic, message in photos.messages(camera, number % PHASES, stamp).items():
                    offline.feed(camera_topic(NAME, camera, topic), message, stamp)

    full = REMEMBERED + 10 * PHASES
    feed(0, full)
    blocks, in_use = _held()
    feed(full, FRAMES)
    more_blocks, more_in_use = _held()
    assert more_blocks - blocks < FRAMES
    assert more_in_use - in_use < 2 * FRAMES * 100  # the stores' rows: a frame's stamp, as long as days are remembered
