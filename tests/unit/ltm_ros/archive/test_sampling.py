"""Which frames of an archive are chosen."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.small_site import write_small_site

from ltm_core.base.errors import ArchiveError
from ltm_core.base.number_text import DAY_NS
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.site.site_io import load_site
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.sampling import Sample, sampled, spans

HOUR_NS = DAY_NS // 24
FOUR = Sample.parsed("4/day")

CAMERA, POSE = Camera.from_fov(6, 4, 60.0), Pose.from_angles((0, 0, 0), 0.0)


def frame(camera: str, stamp_ns: int, content: str = "") -> ArchiveFrame:
    return ArchiveFrame(camera, stamp_ns, "a.mcap", "/ridge/image", stamp_ns, 5, content, CAMERA, POSE, np.eye(6))


def hourly(day: int, begin: int = 0, end: int = 24) -> list[ArchiveFrame]:
    return [frame("east", day * DAY_NS + hour * HOUR_NS) for hour in range(begin, end)]


def hours(frames: Iterable[ArchiveFrame]) -> list[int]:
    return [(frame.stamp_ns % DAY_NS) // HOUR_NS for frame in frames]


def test_images_are_spread_over_the_day_and_several_days_cover_all_hours() -> None:
    taken = [hours(sampled(hourly(3, 6, 18), 4, lambda one: "", turn)[0]) for turn in range(12)]
    for of_day in taken:
        assert [(hour - 6) // 3 for hour in of_day] == [0, 1, 2, 3]
    assert {hour for of_day in taken for hour in of_day} == set(range(6, 18))


def test_a_camera_that_sends_more_has_no_more_images() -> None:
    burst = [frame("east", 3 * DAY_NS + 9 * HOUR_NS + second * 10**9) for second in range(1, 500)]
    found, _ = sampled([*hourly(3, 6, 10), *burst, *hourly(3, 10, 18)], 4, lambda one: "", 0)
    assert len(found) == 4
    assert sampled([], 4, lambda one: "", 0) == ([], [])


def test_foggy_hours_give_no_image_and_few_are_looked_at() -> None:
    found, reasons = sampled(hourly(3), 4, lambda one: "fog" if hours([one]) < [12] else "", 0)
    assert [hour // 6 for hour in hours(found)] == [2, 3]
    assert reasons == ["fog"] * 8


def test_days_begin_in_the_site_s_night_and_have_daylight_alone(tmp_path: Path) -> None:
    """Of early January in California: from 16 to 1 h UTC."""
    site = write_small_site(tmp_path, recording=False).site
    found = spans([*hourly(3), *hourly(4)], FOUR, site)
    assert [hours(of_day) for of_day in found.values()] == [[0], [*range(16, 24), 0], [*range(16, 24)]]
    assert all(len(of_hour) == 1 for of_hour in spans(hourly(3), Sample.parsed("1/hour"), site).values())


def test_days_without_a_sun_count_as_a_whole(tmp_path: Path) -> None:
    """At 78 degrees north the sun stays down in January and up in June."""
    write_small_site(tmp_path, recording=False)
    content = yaml.safe_load((tmp_path / "site.yaml").read_text())
    content |= {"crs": "EPSG:32633", "origin": [500_000.0, 8_658_000.0]}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(content))
    site = load_site(tmp_path / "site.yaml")
    counts = []
    for month in ("01-10", "03-25", "06-20"):
        day = int(np.datetime64(f"2026-{month}", "D").astype(int))
        counts.append(sum(map(len, spans(hourly(day), FOUR, site).values())))
    assert counts[0] == counts[2] == 24
    assert 5 < counts[1] < 15


@pytest.mark.parametrize("text", ["", "0/day", "4", "4/week", "-1/day", "some"])
def test_other_words_are_rejected(text: str) -> None:
    with pytest.raises(ArchiveError):
        Sample.parsed(text)


@pytest.mark.parametrize("text", ["all", "4/day", "12/hour"])
def test_says_itself(text: str) -> None:
    assert Sample.parsed(text).described == text
