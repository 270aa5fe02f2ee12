from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from PIL.Image import Exif
from PIL.TiffImagePlugin import IFDRational

from ltm_ros.recordings.importing.exif import ExifFacts, exif_facts, xmp_values

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
        photo={0x9003: "2024:07:04 18:30:15", 0x9011: "-07:00", 0x9291: "250"},
        gps={1: "N", 2: (34.0, 13.0, 30.0), 3: "W", 4: (118.0, 3.0, 36.0), 5: b"\0", 6: 1742.5, 16: "T", 17: 231.25},
    )
    assert found.sensed.lat == pytest.approx(34 + 13 / 60 + 30 / 3600, abs=1e-9)
    assert found.sensed.lon == pytest.approx(-(118 + 3 / 60 + 36 / 3600), abs=1e-9)
    assert (found.sensed.altitude, found.sensed.azimuth_deg, found.sensed.azimuth_ref) == (1742.5, 231.25, "T")
    assert found.orientation == 1
    assert found.taken == datetime(2024, 7, 4, 18, 30, 15, 250_000, timezone(timedelta(hours=-7)))


def test_a_long_word_in_xmp_takes_no_quadratic_time() -> None:
    assert xmp_values("a" * 500_000 + ' <x-y:Pitch>2</x-y:Pitch> z:Yaw="1"') == {"x-y:Pitch": "2", "z:Yaw": "1"}


def test_south_west_below_the_sea_and_magnetic() -> None:
    found = facts(gps={1: "S", 2: (33.5, 0, 0), 3: "W", 4: (70.25, 0, 0), 5: b"\1", 6: 12.0, 16: "M", 17: 359.5})
    assert (found.sensed.lat, found.sensed.lon, found.sensed.altitude) == (-33.5, -70.25, -12.0)
    assert (found.sensed.azimuth_deg, found.sensed.azimuth_ref) == (359.5, "M")


@pytest.mark.parametrize(
    ("gps", "known"),
    [
        ({1: "N", 2: (IFDRational(0, 0), 0, 0), 3: "E", 4: (10, 0, 0)}, None),
        ({1: "N", 2: (0, 0, 0), 3: "E", 4: (0, 0, 0)}, None),
        ({1: "N", 2: (45.5, IFDRational(0, 0), IFDRational(0, 0)), 3: "E", 4: (10, 0, 0)}, 45.5),
    ],
)
def test_a_fix_that_is_none_is_left_out(gps: dict[int, Any], known: float | None) -> None:
    assert facts(gps=gps).sensed.lat == known


def test_the_camera_clock_and_the_gps_stamp_are_two_things() -> None:
    photo = {0x9003: "2024:07:04 18:30:15"}
    gps = {7: (1.0, 30.0, 16.5), 29: "2024:07:05"}
    found = facts(photo=photo, gps=gps)
    assert found.taken == datetime(2024, 7, 4, 18, 30, 15)
    assert found.gps_time == datetime(2024, 7, 5, 1, 30, 16, 500_000, UTC)
    assert facts(photo=photo).gps_time is None
    assert facts(main={0x0132: "2013:08:25 11:04:17"}).taken == datetime(2013, 8, 25, 11, 4, 17)


ORIGINAL, DIGITIZED, CHANGED = "2024:07:04 18:30:15", "2024:07:05 09:00:00", "2025:01:02 03:04:05"


@pytest.mark.parametrize(
    ("main", "photo", "taken"),
    [
        ({0x0132: CHANGED}, {0x9003: ORIGINAL, 0x9004: DIGITIZED}, "2024-07-04T18:30:15"),
        ({0x0132: CHANGED}, {0x9004: DIGITIZED, 0x9292: "5"}, "2024-07-05T09:00:00.500000"),
        ({0x0132: CHANGED}, {0x9003: "0000:00:00 00:00:00", 0x9004: DIGITIZED}, "2024-07-05T09:00:00"),
        # The zone and the fraction of the last change are not those of the exposure,
        ({0x0132: CHANGED}, {0x9003: ORIGINAL, 0x9010: "+09:00", 0x9290: "7"}, "2024-07-04T18:30:15"),
        # unless both are the same time.
        ({0x0132: ORIGINAL}, {0x9003: ORIGINAL, 0x9010: "-07:00"}, "2024-07-04T18:30:15-07:00"),
        ({}, {0x9003: ORIGINAL, 0x9011: "+23:45"}, "2024-07-04T18:30:15"),
        ({}, {0x9003: ORIGINAL, 0x9011: "   :  "}, "2024-07-04T18:30:15"),
        ({}, {0x9003: "2024-07-04T18:30:15", 0x9011: "Z"}, "2024-07-04T18:30:15+00:00"),
        ({}, {0x9003: "2024/07/04 18:30:15"}, "2024-07-04T18:30:15"),
    ],
)
def test_the_date_of_the_exposure_precedes_those_of_later_steps(
    main: dict[int, Any], photo: dict[int, Any], taken: str
) -> None:
    found = facts(main=main, photo=photo)
    assert found.taken == datetime.fromisoformat(taken)
    assert not found.changed


@pytest.mark.parametrize(
    ("version", "reference", "altitude", "above_sea"),
    [
        (b"0232", b"\0", 250.0, False),
        (b"0232", b"\1", -250.0, False),
        (b"0300", b"\2", 250.0, True),
        (b"0300", b"\3", -250.0, True),
        (b"0300", b"\1", -250.0, False),
        (b"0232", b"1", -250.0, False),
        (b"0232", b"2", 250.0, True),
        (b"0232", b"\xff", 250.0, False),
    ],
)
def test_altitude_references(version: bytes, reference: Any, altitude: float, above_sea: bool) -> None:
    found = facts(photo={0x9000: version}, gps={5: reference, 6: 250.0})
    assert (found.sensed.altitude, found.sensed.ellipsoidal is False) == (altitude, above_sea)


@pytest.mark.parametrize(("value", "known"), [(360.0, 0.0), (359.99, 359.99), (655.35, None)])
def test_directions(value: float, known: float | None) -> None:
    assert facts(gps={16: "M", 17: value}).sensed.azimuth_deg == known


NORTH_WEST = {1: "N", 2: (34.5, 0, 0), 3: "W", 4: (118.25, 0, 0)}


@pytest.mark.parametrize(
    ("changes", "position"),
    [
        ({}, (34.5, -118.25)),
        ({3: None}, None),  # Los Angeles would be in China
        ({1: ""}, None),
        ({3: "w\0"}, (34.5, -118.25)),
        ({3: "West"}, (34.5, -118.25)),
        ({4: (118.0, 15.0, 3050.0)}, None),  # hundredths of a second
        ({18: "TOKYO"}, None),
        ({18: "WGS-84"}, (34.5, -118.25)),
    ],
)
def test_positions_that_are_not_certain_are_left_out(
    changes: dict[int, Any], position: tuple[float, float] | None
) -> None:
    found = facts(gps={tag: value for tag, value in (NORTH_WEST | changes).items() if value is not None})
    assert (found.sensed.lat, found.sensed.lon) == (position or (found.sensed.lat, None))
    assert position is not None or found.sensed.lat is None or found.sensed.lon is None


@pytest.mark.parametrize(("letter", "lon"), [("W", -118.25), ("E", None), ("", None)])
def test_a_longitude_with_a_sign_and_a_letter(letter: str, lon: float | None) -> None:
    written = Exif()
    written.get_ifd(GPS).update(NORTH_WEST | {3: letter, 4: (-118.25, 0, 0)})
    assert exif_facts(written, "a.jpg").sensed.lon == lon
