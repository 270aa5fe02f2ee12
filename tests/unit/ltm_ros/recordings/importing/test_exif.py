from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from PIL.Image import Exif
from PIL.TiffImagePlugin import IFDRational

from ltm_core.base.errors import ImageError
from ltm_ros.recordings.importing.exif import ExifFacts, exif_facts

PHOTO, GPS = 0x8769, 0x8825


def exif(
    main: dict[int, Any] | None = None, photo: dict[int, Any] | None = None, gps: dict[int, Any] | None = None
) -> Exif:
    """EXIF as Pillow gives it after a trip through its own bytes."""
    made = Exif()
    made.update(main or {})
    made.get_ifd(PHOTO).update(photo or {})
    made.get_ifd(GPS).update(gps or {})
    read = Exif()
    read.load(made.tobytes())
    return read


def facts(**ifds: dict[int, Any]) -> ExifFacts:
    return exif_facts(exif(**ifds), "a.jpg")


def test_a_phone_photo_tells_where_and_when() -> None:
    found = facts(
        photo={0x9003: "2024:07:04 18:30:15", 0x9011: "-07:00", 0x9291: "250", 0x920A: 6.86, 0xA405: 24},
        gps={1: "N", 2: (34.0, 13.0, 30.0), 3: "W", 4: (118.0, 3.0, 36.0), 5: b"\0", 6: 1742.5, 16: "T", 17: 231.25},
    )
    assert found.lat == pytest.approx(34 + 13 / 60 + 30 / 3600, abs=1e-9)
    assert found.lon == pytest.approx(-(118 + 3 / 60 + 36 / 3600), abs=1e-9)
    assert (found.altitude, found.direction_deg, found.direction_ref) == (1742.5, 231.25, "T")
    assert (found.focal_35mm, found.orientation) == (24, 1)
    assert found.taken == datetime(2024, 7, 4, 18, 30, 15, 250_000, timezone(timedelta(hours=-7)))


def test_south_west_below_the_sea_and_magnetic() -> None:
    found = facts(gps={1: "S", 2: (33.5, 0, 0), 3: "W", 4: (70.25, 0, 0), 5: b"\1", 6: 12.0, 16: "M", 17: 359.5})
    assert (found.lat, found.lon, found.altitude) == (-33.5, -70.25, -12.0)
    assert (found.direction_deg, found.direction_ref) == (359.5, "M")


def test_no_exif_is_no_facts() -> None:
    assert facts() == ExifFacts()


@pytest.mark.parametrize(
    ("gps", "known"),
    [
        ({1: "N", 2: (IFDRational(0, 0), 0, 0), 3: "E", 4: (10, 0, 0)}, None),
        ({1: "N", 2: (0, 0, 0), 3: "E", 4: (0, 0, 0)}, None),
        ({1: "N", 2: (45.5, IFDRational(0, 0), IFDRational(0, 0)), 3: "E", 4: (10, 0, 0)}, 45.5),
    ],
)
def test_a_fix_that_is_none_is_left_out(gps: dict[int, Any], known: float | None) -> None:
    assert facts(gps=gps).lat == known


def test_fractions_over_zero_are_left_out() -> None:
    found = facts(photo={0x920A: IFDRational(0, 0)}, gps={6: IFDRational(1, 0), 17: IFDRational(0, 0), 16: "T"})
    assert (found.focal_mm, found.altitude, found.direction_deg) == (None, None, None)


@pytest.mark.parametrize(
    "gps", [{1: "N", 2: (91, 0, 0), 3: "E", 4: (0, 0, 0)}, {1: "N", 2: (1, 0, 0), 3: "E", 4: (181, 0, 0)}]
)
def test_a_position_off_the_globe_is_refused(gps: dict[int, Any]) -> None:
    with pytest.raises(ImageError, match=r"a\.jpg: invalid EXIF position"):
        facts(gps=gps)


def test_the_camera_clock_and_the_gps_stamp_are_two_things() -> None:
    photo = {0x9003: "2024:07:04 18:30:15"}
    gps = {7: (1.0, 30.0, 16.5), 29: "2024:07:05"}
    found = facts(photo=photo, gps=gps)
    assert found.taken == datetime(2024, 7, 4, 18, 30, 15)
    assert found.gps_time == datetime(2024, 7, 5, 1, 30, 16, 500_000, UTC)
    assert facts(photo=photo).gps_time is None
    assert facts(main={0x0132: "2013:08:25 11:04:17"}).taken == datetime(2013, 8, 25, 11, 4, 17)


@pytest.mark.parametrize(("value", "known"), [(4.75, 4.75), (0, None), (IFDRational(0, 0), None)])
def test_the_horizontal_positioning_error(value: Any, known: float | None) -> None:
    assert facts(gps={31: value}).position_error == known


@pytest.mark.parametrize("text", ["0000:00:00 00:00:00", "    :  :     :  :  ", "yesterday", ""])
def test_dates_that_are_none_are_left_out(text: str) -> None:
    assert facts(photo={0x9003: text}).taken is None
    assert facts(photo={0x9003: text}, gps={7: (1, 2, 3), 29: "2024:13:40"}).gps_time is None


@pytest.mark.parametrize("orientation", [0, 9, 65535])
def test_an_orientation_that_is_none_is_upright(orientation: int) -> None:
    assert facts(main={0x0112: orientation}).orientation == 1


@pytest.mark.parametrize(("width", "height"), [(4000, 3000), (3000, 4000)])
def test_focal_length_from_35_mm_is_over_the_long_side(width: int, height: int) -> None:
    assert facts(photo={0xA405: 27}).focal_px(width, height) == pytest.approx(27 / 36 * 4000)


def test_focal_length_from_a_stated_sensor() -> None:
    """30 mm on a sensor of 22.0 mm over 4290 pixels; the 35 mm equivalent gives way."""
    assert facts(photo={0x920A: 30.0, 0xA405: 99}).focal_px(4290, 2856, 22.0) == pytest.approx(5850.0)


def test_focal_length_from_the_focal_plane_follows_a_resized_image() -> None:
    photo = {0x920A: 30.0, 0xA20E: 4272 / 22.3 * 25.4, 0xA210: 2, 0xA002: 4272}
    assert facts(photo=photo).focal_px(4272, 2848) == pytest.approx(30 / 22.3 * 4272, rel=1e-6)
    assert facts(photo=photo).focal_px(2136, 1424) == pytest.approx(30 / 22.3 * 2136, rel=1e-6)


def test_a_focal_plane_that_contradicts_the_35_mm_equivalent_gives_way() -> None:
    photo = {0x920A: 30.0, 0xA20E: 100.0, 0xA210: 2, 0xA405: 48}
    assert facts(photo=photo).focal_px(4272, 2848) == pytest.approx(48 / 36 * 4272)


def test_without_a_sensor_millimetres_tell_nothing() -> None:
    assert facts(photo={0x920A: 30.0}).focal_px(4290, 2856) is None
    assert facts().focal_px(4290, 2856, 22.0) is None
