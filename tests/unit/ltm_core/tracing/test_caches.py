from dataclasses import replace

import numpy as np
import pytest
from scenes.rasters import rough_terrain

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.tracer import BoundedCache, Way

CAMERA = Camera(301, 201, 210.0, 210.0, 150.0, 100.0)
POSITION = (100.0, -80.0, 880.0)


def test_the_least_recently_used_goes_first() -> None:
    cache = BoundedCache[bytes](10, len)
    cache.put("a", b"1234")
    cache.put("b", b"1234")
    assert cache.get("a") == b"1234"
    cache.put("c", b"123")
    assert cache.get("b") is None
    assert cache.get("a") is not None
    assert cache.held_bytes == 7
    cache.put("a", b"12345678901")
    assert cache.get("a") is None
    assert cache.held_bytes == 0


@pytest.mark.parametrize(("way", "kept"), [("auto", 1), ("pyramid", 2)])
def test_tracers_that_cache_share_the_memory_and_each_keeps_its_last_frame(way: Way, kept: int) -> None:
    dem, poses = rough_terrain(14), [Pose.from_angles(POSITION, azimuth, -20, 0) for azimuth in (10, 40)]
    others = [TerrainTracer(dem) for _ in range(600)]
    for other in others:
        other.trace(Camera(2, 1, 2.0, 2.0, 0.5, 0.0), poses[0], way)
    tracer = TerrainTracer(dem)
    profiles = []
    for pose in poses:
        last = tracer.trace(CAMERA, pose).range
        profiles.append(tracer.statistics.profile_bytes > 0)
    assert profiles == [kept > 1, True]  # of many, one that has not turned keeps no profile
    assert tracer.statistics.frame_bytes == kept * last.nbytes
    assert tracer.trace(CAMERA, poses[-1]).range is last


def test_a_fixed_camera_is_traced_once() -> None:
    tracer = TerrainTracer(rough_terrain(14))
    pose = Pose.from_angles(POSITION, 10, -20, 0)
    first = tracer.trace(CAMERA, pose)
    again = tracer.trace(CAMERA, Pose.from_angles(POSITION, 10, -20, 0))
    assert again.range is first.range
    with pytest.raises(ValueError, match="read-only"):
        first.range[0, 0] = 1.0
    assert tracer.statistics.frames == 2
    assert tracer.statistics.frame_hits == 1
    assert tracer.statistics.frame_bytes == first.range.nbytes


def test_a_position_is_profiled_once() -> None:
    tracer = TerrainTracer(rough_terrain(14))
    tracer.trace(CAMERA, Pose.from_angles(POSITION, 10, -20, 0))
    held = tracer.statistics.profile_bytes
    assert held > 0
    tracer.trace(CAMERA.scaled(4), Pose.from_angles(POSITION, 10, -20, 0))
    zoomed = replace(CAMERA, fx=500.0, fy=500.0)
    tracer.trace(zoomed, Pose.from_angles(POSITION, 12, -19, 3))
    assert tracer.statistics.profile_hits == 2
    assert tracer.statistics.profile_bytes == held
    turned = tracer.trace(CAMERA, Pose.from_angles(POSITION, 190, -20, 0))
    assert tracer.statistics.profile_hits == 2
    assert tracer.statistics.profile_bytes > held
    assert tracer.statistics.frame_hits == 0
    slow = tracer.trace(CAMERA, Pose.from_angles(POSITION, 190, -20, 0), way="pyramid")
    np.testing.assert_array_equal(turned.range, slow.range)


def test_a_moving_camera_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ltm_core.tracing.tracer.PROFILE_BYTES", 2_000_000)
    monkeypatch.setattr("ltm_core.tracing.tracer.FRAME_BYTES", 1_000_000)
    tracer = TerrainTracer(rough_terrain(14))
    for k in range(20):
        tracer.trace(CAMERA, Pose.from_angles((100.0 + k, -80.0, 880.0), 18.0 * k, -20, 0))
        assert tracer.statistics.profile_bytes <= 2_000_000
        assert tracer.statistics.frame_bytes <= 1_000_000
    assert tracer.statistics.frame_bytes > 0
