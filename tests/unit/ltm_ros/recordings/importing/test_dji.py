from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from PIL import Image
from scenes.movie_file import movie
from scenes.phone_site import FRAME, FX, GROUND, LAT, LON, imported, phone_site, picture

from ltm_core.base.errors import PoseError, RecordingError
from ltm_core.geometry.pose import pose_covariance
from ltm_core.site.site import Site
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.importing.dji import read_subtitles

FACTS = {
    "GpsStatus": "RTK",
    "AltitudeType": "GpsFusionAlt",
    "GpsLatitude": f"{LAT:.9f}",
    "GpsLongitude": f"{LON:.9f}",
    "AbsoluteAltitude": f"+{GROUND + 61.5:.2f}",
    "RelativeAltitude": "+60.00",
    "GimbalRollDegree": "+0.40",
    "GimbalYawDegree": "-128.30",
    "GimbalPitchDegree": "-21.50",
    "FlightYawDegree": "+12.00",
    "CalibratedFocalLength": "43.5",
    "CalibratedOpticalCenterX": "31.0",
    "CalibratedOpticalCenterY": "20.5",
}


def photo(path: Path, elements: bool = False, **changes: str | None) -> Path:
    """A JPEG with a DJI's XMP packet, its facts as attributes or (newer drones) as elements."""
    facts = {key: value for key, value in {**FACTS, **changes}.items() if value is not None}
    inner = "".join(f"<drone-dji:{k}>{v}</drone-dji:{k}>" for k, v in facts.items()) if elements else ""
    attributes = "" if elements else " ".join(f'drone-dji:{k}="{v}"' for k, v in facts.items())
    xmp = (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="DJI Meta Data" '
        f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {attributes}>{inner}</rdf:Description></rdf:RDF>'
        '</x:xmpmeta><?xpacket end="w"?>'
    )
    image = Image.fromarray(picture())
    exif = image.getexif()
    exif.get_ifd(0x8769).update({0x9003: "2024:07:05 01:30:15", 0x9011: "+00:00", 0xA405: 24})
    image.save(path, "JPEG", exif=exif.tobytes(), xmp=xmp.encode())
    return path


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return phone_site(tmp_path)


@pytest.mark.parametrize("elements", [False, True])
def test_a_drones_photo_is_placed_by_its_gimbal(tmp_path: Path, site: Site, elements: bool) -> None:
    """Not by the aircraft, which flies another way."""
    import_photos([photo(tmp_path / "DJI_0001.JPG", elements)], tmp_path / "bag", site=site)
    ((_, camera, pose, covariance),) = imported(tmp_path / "bag")
    x, y = (float(v) for v in FRAME.from_lonlat(LON, LAT))
    np.testing.assert_allclose(pose.position, [x, y, GROUND + 61.5], atol=1e-3)
    azimuth = FRAME.true_to_grid_deg(360 - 128.3, x, y)
    np.testing.assert_allclose(pose.angles_deg, [azimuth, -21.5, 0.4], atol=1e-6)
    assert (camera.fx, camera.cx, camera.cy) == (43.5, 31.0, 20.5)
    np.testing.assert_allclose(covariance, pose_covariance(pose, 5.0, 10.0, 8.2, 0.5, 0.5), atol=1e-9)


def test_rtk_says_how_sure_it_is_and_counts_from_the_ellipsoid(tmp_path: Path, site: Site) -> None:
    changes = {"RtkStdLon": "0.03", "RtkStdLat": "0.05", "RtkStdHgt": "0.08", "AltitudeType": "RtkAlt"}
    path = photo(tmp_path / "DJI_0001.JPG", AbsoluteAltitude=f"{GROUND + 61.5 - 35.4:.2f}", **changes)
    import_photos([path], tmp_path / "bag", site=site, assumed=Assumptions(geoid_undulation=-35.4))
    ((_, _, pose, covariance),) = imported(tmp_path / "bag")
    assert pose.position[2] == pytest.approx(GROUND + 61.5, abs=0.01)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(np.hypot(0.03, 0.05) / np.sqrt(2))
    assert np.sqrt(covariance[2, 2]) == pytest.approx(0.08)


def test_a_height_above_the_take_off_needs_its_height(tmp_path: Path, site: Site) -> None:
    path = photo(tmp_path / "DJI_0001.JPG")
    import_photos([path], tmp_path / "bag", site=site, assumed=Assumptions(start_height=GROUND - 7.0))
    ((_, _, pose, _),) = imported(tmp_path / "bag")
    assert pose.position[2] == pytest.approx(GROUND - 7.0 + 60.0)


NEW = (
    '{n}\n00:00:0{s},000 --> 00:00:0{s},033\n<font size="28">FrameCnt: {n}, DiffTime: 33ms\n2024-07-04 18:30:1{t}.500\n'
    "[iso: 100] [shutter: 1/944.10] [fnum: 3.7] [ev: 0] [color_md : default] [focal_len: 27.00] [dzoom_ratio: 1.00], "
    "[latitude: {lat:.6f}] [longitude: {lon:.6f}] [rel_alt: {climb:.3f} abs_alt: {alt:.3f}] "
    "[gb_yaw: {yaw:.1f} gb_pitch: -12.0 gb_roll: 0.5] </font>\n\n"
)


def flight(template: str) -> str:
    """Going north by 1e-5 degrees a second, turning from 350 to 10 degrees."""
    return "".join(
        template.format(
            n=s + 1, s=s, t=5 + s, lat=LAT + 1e-5 * s, lon=LON, climb=40.0 + s, alt=GROUND + 50 + s, yaw=-10.0 + 10 * s
        )
        for s in range(3)
    )


def test_a_drones_video_is_placed_by_the_subtitles_beside_it(tmp_path: Path, site: Site) -> None:
    (tmp_path / "DJI_0002.MP4").write_bytes(movie([picture()] * 6, 2, datetime(2001, 1, 1, tzinfo=UTC)))
    (tmp_path / "DJI_0002.SRT").write_text(flight(NEW))
    assumed = Assumptions(time_zone=ZoneInfo("America/Los_Angeles"))
    import_photos([tmp_path / "DJI_0002.MP4"], tmp_path / "bag", site=site, assumed=assumed)
    rows = imported(tmp_path / "bag")
    assert [stamp for stamp, *_ in rows] == [1_720_143_015_500_000_000 + s * 10**9 for s in range(3)]
    for s, (_, camera, pose, _) in enumerate(rows):
        assert camera.fx == pytest.approx(FX)
        x, y = (float(v) for v in FRAME.from_lonlat(LON, LAT + 1e-5 * s))
        np.testing.assert_allclose(pose.position, [x, y, GROUND + 50 + s], atol=0.06)
        azimuth = FRAME.true_to_grid_deg(350.0 + 10 * s, x, y)
        np.testing.assert_allclose(pose.angles_deg, [azimuth, -12.0, 0.5], atol=1e-6)


@pytest.mark.parametrize(
    ("block", "position", "covered", "climb"),
    [
        ("GPS(36.6146,-6.1120,0.0M) BAROMETER:0.3M", (36.6146, -6.112), None, 0.3),  # Matrice 300, in Spain
        ("GPS(149.0251,-20.2533,16) Hb:1.9 Hs:1.9", (-20.2533, 149.0251), None, 1.9),  # Inspire
        ("GPS (8.2090, 47.4692, 18), D 49.21m, H 45.60m, H.S 0.00m/s", (47.4692, 8.209), None, 45.6),  # Phantom 4 Pro
        ("GPS (-58.85, -34.24, 15), HOME (-58.84, -34.23, -57.98m), H 85.80m", (-34.24, -58.85), None, 85.8),
        ("GPS (8.2090, 47.4692, 18), D 161ft, H 150ft, H.S n/a", (47.4692, 8.209), None, 45.72),
        ("GPS (-121.7458, 48.0771, 12.5)", (48.0771, -121.7458), None, None),  # only that is on the globe
        ("GPS (36.6146, -6.1120)", (36.6146, -6.112), (36.6, -6.1), None),
        ("GPS (36.6146, -6.1120)", (-6.112, 36.6146), (-6.1, 36.6), None),
        ("GPS(36.6146,-6.1120,14) BAROMETER:0.3", (36.6146, -6.112), (36.6, -6.1), 0.3),  # against its format
        ("[latitude: 34.2250] [longtitude: -118.0600] [altitude: 26.60]", (34.225, -118.06), None, 26.6),
        ("[latitude: 34,2250] [longitude: -118,0600] [rel_alt: 1,300 abs_alt: 132,860]", (34.225, -118.06), None, 1.3),
    ],
)
def test_the_order_of_coordinates_and_what_heights_count_from(
    tmp_path: Path,
    block: str,
    position: tuple[float, float],
    covered: tuple[float, float] | None,
    climb: float | None,
) -> None:
    (tmp_path / "a.SRT").write_text(f"1\n00:00:00,000 --> 00:00:01,000\n\n2\n00:00:01,000 --> 00:00:02,000\n{block}\n")

    def covers(lon: float, lat: float) -> bool:
        return covered is not None and np.hypot(lat - covered[0], lon - covered[1]) < 1

    found = read_subtitles(tmp_path / "a.SRT", covers).track.at(1 + 10**9, np.eye(3))
    assert (found.lat, found.lon) == position
    assert found.climb == (None if climb is None else pytest.approx(climb))
    assert found.altitude == (132.86 if "abs_alt" in block else None)


def test_an_order_that_nothing_decides_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.SRT").write_text("1\n00:00:00,000 --> 00:00:01,000\nGPS (36.6146, -6.1120)\n")
    with pytest.raises(RecordingError, match=r"36\.6146.*--site"):
        read_subtitles(tmp_path / "a.SRT")


def test_a_lens_that_zooms_during_the_video(tmp_path: Path) -> None:
    text = flight(NEW)
    (tmp_path / "a.SRT").write_text(text[: text.index("3\n00")] + text[text.index("3\n00") :].replace("27.00", "48.00"))
    lenses = [read_subtitles(tmp_path / "a.SRT").lens_at(at) for at in (0.0, 1.9, 2.0, 60.0)]
    assert [lens.focal_35mm for lens in lenses if lens is not None] == [27.0, 27.0, 48.0, 48.0]


@pytest.mark.parametrize(
    ("heights", "start", "z"),
    [
        ("[altitude: 1561.5]", None, None),  # above the take-off place or above sea level: nothing states it
        ("[altitude: 61.5]", GROUND, GROUND + 61.5),
        ("", None, None),
        ("", GROUND, None),
        ("[rel_alt: 61.5 abs_alt: 1561.5]", None, GROUND + 61.5),
    ],
)
def test_a_height_of_unknown_origin_needs_the_take_offs(
    tmp_path: Path, site: Site, heights: str, start: float | None, z: float | None
) -> None:
    (tmp_path / "DJI_0002.MP4").write_bytes(movie([picture()] * 2, 2, datetime(2024, 7, 5, 1, tzinfo=UTC)))
    text = re.sub(r"\[rel_alt[^]]*\]", heights, flight(NEW))
    (tmp_path / "DJI_0002.SRT").write_text(text)
    assumed = Assumptions(start_height=start, time_zone=ZoneInfo("America/Los_Angeles"))
    if z is None:
        with pytest.raises(PoseError, match="--start-height" if heights else "pose file"):
            import_photos([tmp_path / "DJI_0002.MP4"], tmp_path / "bag", site=site, assumed=assumed)
    else:
        import_photos([tmp_path / "DJI_0002.MP4"], tmp_path / "bag", site=site, assumed=assumed)
        assert imported(tmp_path / "bag")[0][2].position[2] == pytest.approx(z)
