import gc
import sys
from pathlib import Path

import pytest
from chaos.cameras import CAMERAS, PHASES, Photos
from chaos.living_site import write_living_site
from scenes.small_site import NAME

from ltm_core.pipeline.site_surface import UNCOMMITTED
from ltm_ros.launching.graph import describe
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.stamp_join import REMEMBERED
from ltm_ros.runtime.topics import camera_topic

pytestmark = pytest.mark.slow

FRAMES = UNCOMMITTED // len(CAMERAS)
"""Of each camera, between the two counts: as many of them wait for the terrain's next commit then."""


def _held() -> int:
    """Blocks of Python's allocator that are in use."""
    gc.collect()
    return sys.getallocatedblocks()


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
    blocks = _held()
    feed(full, FRAMES)
    assert _held() - blocks < FRAMES
