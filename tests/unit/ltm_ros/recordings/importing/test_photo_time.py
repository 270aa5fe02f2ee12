from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest

from ltm_ros.recordings.importing.assumptions import photo_time, time_zone
from ltm_ros.recordings.importing.exif import ExifFacts, Sensed
from ltm_ros.recordings.importing.photo import Photo

SUMMER = datetime(2024, 7, 4, 18, 30, 15)
WEST = timezone(timedelta(hours=-7))


def when(
    clock: datetime | None, gps: datetime | None = None, zone: str | None = None, stated: datetime | None = None
) -> tuple[datetime, list[str]]:
    photo = Photo(Path("a.jpg"), b"", "jpeg", 4, 3, ExifFacts(taken=clock, gps_time=gps), Sensed(), False)
    notes: list[str] = []
    return photo_time(photo, stated, time_zone(zone) if zone else None, notes), notes


def test_exifs_own_offset_goes_before_everything_but_a_row() -> None:
    assert when(SUMMER.replace(tzinfo=WEST), zone="Europe/Oslo") == (datetime(2024, 7, 5, 1, 30, 15, tzinfo=UTC), [])
    stated = datetime(2020, 1, 1, 12)
    assert when(SUMMER.replace(tzinfo=WEST), stated=stated) == (stated.replace(tzinfo=UTC), [])


def test_a_zone_knows_its_summer_time() -> None:
    assert when(SUMMER, zone="Europe/Oslo") == (datetime(2024, 7, 4, 16, 30, 15, tzinfo=UTC), [])
    winter = SUMMER.replace(month=1)
    assert when(winter, zone="Europe/Oslo") == (datetime(2024, 1, 4, 17, 30, 15, tzinfo=UTC), [])


def test_an_hour_that_comes_twice_is_told_of() -> None:
    taken, (note,) = when(datetime(2024, 10, 27, 2, 30), zone="Europe/Oslo")
    assert taken.astimezone(UTC) == datetime(2024, 10, 27, 0, 30, tzinfo=UTC)
    assert "clock change of Europe/Oslo" in note


def test_without_a_zone_the_gps_stamp_counts() -> None:
    gps = datetime(2024, 7, 5, 1, 30, 17, tzinfo=UTC)
    assert when(SUMMER, gps) == (gps, [])
    assert when(None, gps) == (gps, [])
    unset, (note,) = when(datetime(1980, 1, 1, tzinfo=UTC))
    assert unset.year == 1980
    assert "stamp" in note
    taken, (note,) = when(SUMMER)
    assert taken == SUMMER.replace(tzinfo=UTC)
    assert "--time-zone" in note


@pytest.mark.parametrize(
    ("clock", "zone", "said"),
    [
        (SUMMER.replace(tzinfo=UTC), None, "differ by 7 h 0 min"),
        (SUMMER, "Europe/Oslo", "differ by 9 h 0 min"),
        (SUMMER.replace(tzinfo=WEST, day=2), None, "differ by 2 d 0 h"),
        (SUMMER.replace(minute=38), None, "6 h 52 min, which is not a time zone"),
        (SUMMER.replace(year=2023), None, "366 d 7 h, which is not a time zone"),
    ],
)
def test_a_gps_stamp_that_contradicts_is_told_of(clock: datetime, zone: str | None, said: str) -> None:
    _, (note,) = when(clock, datetime(2024, 7, 5, 1, 30, 15, tzinfo=UTC), zone)
    assert said in note
