"""The archive benchmark: the simulated month, and the speed of two processes."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes.small_site import FRAMES, write_small_site

from ltm_core.base.errors import ArchiveError
from ltm_core.base.utc_time import DAY_NS
from ltm_lab.bench.archive import measure_speedup, write_days
from ltm_ros.archive.run import ArchiveOptions, Plan, look_through


def test_a_recording_is_repeated_on_each_day(tmp_path: Path) -> None:
    small_site = write_small_site(tmp_path)
    long = write_days(small_site.bag, tmp_path / "long", 3)

    def planned(bag: Path) -> Plan:
        out = str(tmp_path / bag.name)
        return look_through(ArchiveOptions((bag,), small_site.path, out), lambda done, total: None)

    one, three = planned(small_site.bag), planned(long)
    assert (len(one.tasks), len(three.tasks), three.manifest.failures) == (2, 6, [])
    moved = {(f.camera, f.stamp_ns + day * DAY_NS, f.content) for f in one.frames for day in range(3)}
    assert {(f.camera, f.stamp_ns, f.content) for f in three.frames} == moved
    assert len(moved) == 3 * 2 * FRAMES
    with pytest.raises(ArchiveError, match="2 days make 4 tasks, too few"):
        measure_speedup(small_site.bag, small_site.path, tmp_path, 2, lambda words: None)
