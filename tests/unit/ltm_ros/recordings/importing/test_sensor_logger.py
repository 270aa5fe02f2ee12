import io
import math
import zipfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scenes.phone_site import GROUND, LAT, LON, STAMP, imported, phone_site, picture, taken

from ltm_core.base.errors import PoseError, RecordingError
from ltm_core.cameras.sensor_pose import phone_camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, pose_covariance
from ltm_core.site.site import Site
from ltm_lab.simulator.phone_photo_io import PhonePhoto
from ltm_lab.simulator.sensor_logger_io import write_sensor_logger
from ltm_ros.recordings.importing import capture_files
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.importing.capture_files import CaptureFiles
from ltm_ros.recordings.importing.sensor_logger import read_sensor_logger

FRAME = SiteFrame("EPSG:32611", 402_000.0, 3_787_000.0)
LENS = Assumptions(focal_35mm=27.0, height_above_ground=1.6)

WALK = [
    taken(0, (231.0, -3.5, 1.25)),
    taken(1, (118.0, 4.0, -2.0), at=(9.0, 3.0, 0.7), portrait=True),
    taken(2, (5.0, -12.0, 0.5), at=(18.0, 6.0, -0.2)),
]


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return phone_site(tmp_path)


def recorded(folder: Path, platform: Literal["ios", "android"] = "ios", photos: list[PhonePhoto] | None = None) -> Path:
    write_sensor_logger(folder / "walk.zip", photos or WALK, FRAME, 90, -35.4, platform)
    return folder / "walk.zip"


def changed(path: Path, changes: dict[str, str | bytes | None], name: str = "changed.zip") -> Path:
    """A copy with members replaced, left out (None) or added."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(path.parent / name, "w", zipfile.ZIP_DEFLATED) as new:
        for member in old.namelist():
            data = changes.get(member, old.read(member))
            if data is not None:
                new.writestr(member, data)
        for member in changes.keys() - set(old.namelist()):
            data = changes[member]
            new.writestr(member, data)
    return path.parent / name


def member(path: Path, name: str) -> str:
    with zipfile.ZipFile(path) as archive:
        return archive.read(name).decode()


def column_set(text: str, name: str, value: str) -> str:
    """A CSV with one column set to a value in all rows."""
    header, *rows = text.strip().split("\n")
    at = header.split(",").index(name)
    cells = [row.split(",") for row in rows]
    return "\n".join([header, *(",".join([*c[:at], value, *c[at + 1 :]]) for c in cells)]) + "\n"


@pytest.mark.parametrize("platform", ["ios", "android"])
def test_a_walk_is_placed_by_the_phones_sensors(
    tmp_path: Path, site: Site, platform: Literal["ios", "android"]
) -> None:
    """Whichever platform's axes and north it was written with, portrait and landscape."""
    report = import_photos([recorded(tmp_path, platform)], tmp_path / "bag", site=site, assumed=LENS)
    found = imported(tmp_path / "bag")
    assert report.cameras == {"phone": 3}
    for photo, (stamp, camera, pose, covariance) in zip(WALK, found, strict=True):
        assert stamp == photo.stamp_ns
        assert camera == photo.camera
        np.testing.assert_allclose(pose.position[:2], photo.pose.position[:2], atol=2e-3)
        np.testing.assert_allclose(pose.angles_deg, photo.pose.angles_deg, atol=2e-3)
        # The ground falls by 0.9 m from one photo to the next, and the barometer tells just that.
        np.testing.assert_allclose(pose.position[2], photo.pose.position[2], atol=0.05)
        expected = pose_covariance(pose, 4.0, math.hypot(1.0, 1.0), 8.2, 1.0, 1.0)
        np.testing.assert_allclose(covariance, expected, atol=1e-9)


def test_known_attitudes_of_both_platforms(tmp_path: Path) -> None:
    """Worked out by hand: an upright phone with its back to the north, tilted up by 15 degrees, and a fix beside it."""
    half = math.radians(105.0) / 2  # about the screen's side, from flat
    up = f"{math.sin(half)},0,0,{math.cos(half)}"
    location = "time,latitude,longitude,horizontalAccuracy\n" + f"{STAMP},{LAT},{LON},3.5\n"
    for platform, azimuth, yaw, pitch in (
        # Beyond upright the top tilts back to the south: Android's azimuth of the phone's top is then south.
        ("android", 0.0, math.pi, -math.radians(75)),
        # There the same quaternion looks west: the side that lay to the east lies to the north.
        ("ios", 270.0, math.pi, math.radians(75)),
    ):
        orientation = f"time,qx,qy,qz,qw,yaw,pitch,roll\n{STAMP},{up},{yaw},{pitch},{math.pi}\n"
        tables = {
            "Location.csv": location,
            "Orientation.csv": orientation,
            "Metadata.csv": f"version,platform\n3,{platform}\n",
        }
        with zipfile.ZipFile(tmp_path / f"{platform}.zip", "w") as archive:
            for name, text in tables.items():
                archive.writestr(name, text)
        sensed = read_sensor_logger(CaptureFiles(tmp_path / f"{platform}.zip")).at(STAMP, phone_camera())
        assert sensed.azimuth_deg == pytest.approx(azimuth, abs=1e-4)
        assert sensed.pitch_deg == pytest.approx(15.0, abs=1e-4)
        assert sensed.roll_deg == pytest.approx(0.0, abs=1e-4)
        assert sensed.azimuth_ref == ("M" if platform == "android" else "T")
        assert sensed.position_sigma == 3.5


def test_quaternions_that_contradict_their_angles_are_refused(tmp_path: Path) -> None:
    path = recorded(tmp_path)
    wrong = column_set(member(path, "Orientation.csv"), "pitch", "0.9")
    with pytest.raises(RecordingError, match=r"do not match the yaw, pitch and roll.*--poses"):
        read_sensor_logger(CaptureFiles(changed(path, {"Orientation.csv": wrong})))


def test_an_altitude_above_the_ellipsoid_needs_the_geoid(tmp_path: Path, site: Site) -> None:
    """Android has no other; without the geoid's height the terrain tells more."""
    path = recorded(tmp_path, "android")
    empty = column_set(member(path, "Location.csv"), "altitudeAboveMeanSeaLevel", "")
    path = changed(path, {"Barometer.csv": None, "Location.csv": empty})
    report = import_photos([path], tmp_path / "bag", site=site, assumed=LENS)
    assert any("above the WGS 84 ellipsoid" in note and "--geoid-undulation-m" in note for _, note in report.notes)
    assert imported(tmp_path / "bag")[1][2].position[2] == pytest.approx(GROUND - 0.9 + 1.6, abs=0.02)
    known = Assumptions(focal_35mm=27.0, geoid_undulation=-35.4)
    import_photos([path], tmp_path / "known", site=site, assumed=known)
    assert imported(tmp_path / "known")[1][2].position[2] == pytest.approx(WALK[1].pose.position[2], abs=0.01)


def test_what_the_sensors_do_not_tell_is_unknown_and_never_zero(tmp_path: Path, site: Site) -> None:
    path = changed(recorded(tmp_path), {"Orientation.csv": None})
    with pytest.raises(PoseError, match=r"\.jpg has no direction in Sensor Logger.*azimuth_deg.*--refine"):
        import_photos([path], tmp_path / "bag", site=site, assumed=LENS)
    kept = Assumptions(focal_35mm=27.0, height_above_ground=1.6, keep_unknown=True)
    report = import_photos([path], tmp_path / "bag", site=site, assumed=kept)
    assert any("direction is unknown" in note for _, note in report.notes)
    _, _, pose, covariance = imported(tmp_path / "bag")[0]
    np.testing.assert_allclose(
        covariance,
        pose_covariance(pose, 4.0, math.sqrt(2.0), UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, 3.0),
        atol=1e-9,
    )


def negative(path: Path) -> dict[str, str | bytes | None]:
    return {"Location.csv": column_set(member(path, "Location.csv"), "horizontalAccuracy", "-1")}


def nowhere(path: Path) -> dict[str, str | bytes | None]:
    text = column_set(member(path, "Location.csv"), "latitude", "0.0")
    return {"Location.csv": column_set(text, "longitude", "0.0")}


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        (lambda path: {"Location.csv": None}, "without Location: enable the sensor"),
        (negative, r"none of \d+ positions in Location is valid \(negative accuracy"),
        (nowhere, "the phone had no GPS fix"),
        (lambda path: {"Location.csv": "time,lat\n1,2\n"}, "has no column 'latitude'"),
        (lambda path: {"Location.csv": "latitude,longitude\n1,2\n"}, "has no column `time`"),
        (lambda path: {"Location.csv": "a,b,c\n1,2\n3,4,5\n"}, "line 2: has fewer values than the 3 columns"),
        (lambda path: {"Location.csv": b"\xff\xfe\x00"}, "is not text in UTF-8"),
        (lambda path: {"Orientation.csv": "time,yaw\n1,2\n"}, "Orientation has no column 'qx'"),
    ],
)
def test_recordings_that_tell_nothing_are_told_with_the_remedy(
    tmp_path: Path, site: Site, changes: Any, complaint: str
) -> None:
    path = recorded(tmp_path)
    with pytest.raises(RecordingError, match=complaint):
        import_photos([changed(path, changes(path))], tmp_path / "bag", site=site, assumed=LENS)
    assert not (tmp_path / "bag").exists()


def _jpeg() -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture()).save(file, "JPEG")
    return file.getvalue()


class TestArchives:
    """Zips that are broken or made to harm."""

    def test_names_that_climb_out_write_nothing_and_are_no_frames(self, tmp_path: Path, site: Site) -> None:
        folder = tmp_path / "two" / "below"  # where climbing out of it ends is this test's own, too
        folder.mkdir(parents=True)
        path = recorded(folder)
        evil = changed(path, {"../../Camera/1720143015000.jpg": _jpeg(), "/Camera/..jpg": b"x", "Camera/a.jpg": b"x"})
        before = sorted(p for p in tmp_path.rglob("*") if "bag" not in p.parts)
        report = import_photos([evil], folder / "bag", site=site, assumed=LENS)
        assert sorted(p for p in tmp_path.rglob("*") if "bag" not in p.parts) == before
        assert report.cameras == {"phone": 4}  # read from the archive by its name there, and never unpacked

    def test_a_bomb_is_read_no_further_than_its_bound(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(capture_files, "LARGEST_TABLE", 1 << 20)
        bomb = changed(recorded(tmp_path), {"Location.csv": b"0" * (40 << 20)})
        assert bomb.stat().st_size < 1 << 20
        with pytest.raises(RecordingError, match=r"'Location.csv': has more than 1 MiB unpacked"):
            read_sensor_logger(CaptureFiles(bomb))

    def test_too_many_members(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(capture_files, "MOST_MEMBERS", 5)
        with pytest.raises(RecordingError, match="more than 5: split"):
            CaptureFiles(recorded(tmp_path))

    @pytest.mark.parametrize("share", [0.2, 0.6, 0.99])
    def test_a_zip_that_was_cut_short(self, tmp_path: Path, site: Site, share: float) -> None:
        path = recorded(tmp_path)
        path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
        with pytest.raises(RecordingError, match=r"is not a complete zip.*export or copy it again"):
            import_photos([path], tmp_path / "bag", site=site, assumed=LENS)
