from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pillow_heif
import pytest
import yaml
from PIL import Image
from scenes.phone_site import FX, GROUND, LAT, LON, LONG, ORIGIN, SHORT, imported, phone_site, picture

from ltm_core.base.errors import CameraError, ImageError, LtmError, PoseError, RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, magnetic_declination_deg
from ltm_core.geometry.pose import pose_covariance
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.importing.photo import read_photo

LEVEL = Assumptions(pitch_deg=0.0)
W, H = LONG, SHORT
X0, Y0 = ORIGIN


def phone(**changes: Any) -> dict[str, dict[int, Any]]:
    """EXIF of a phone photo; a change `gps_17=None` takes tag 17 out of the GPS part, and so on."""
    ifds: dict[str, dict[int, Any]] = {
        "main": {},
        "photo": {0x9003: "2024:07:04 18:30:15", 0x9011: "-07:00", 0xA405: 27},
        "gps": {
            **{1: "N", 2: (34.0, 13.0, 30.0), 3: "W", 4: (118.0, 3.0, 36.0)},
            **{5: b"\0", 6: GROUND + 12.0, 16: "T", 17: 90.0},
        },
    }
    for key, value in changes.items():
        part, _, tag = key.partition("_")
        ifds[part][int(tag, 0)] = value
    return {part: {t: v for t, v in tags.items() if v is not None} for part, tags in ifds.items()}


def save(path: Path, facts: dict[str, dict[int, Any]] | None = None, pixels: UInt8Array | None = None) -> Path:
    pillow_heif.register_heif_opener()
    image = Image.fromarray(picture() if pixels is None else pixels)
    if facts is None:
        image.save(path, quality=95)
        return path
    exif = image.getexif()
    exif.update(facts["main"])
    exif.get_ifd(0x8769).update(facts["photo"])
    exif.get_ifd(0x8825).update(facts["gps"])
    image.save(path, quality=95, exif=exif.tobytes())
    return path


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return phone_site(tmp_path)


def images_of(bag: Path) -> list[Any]:
    """The compressed image of each photo, after checking that it belongs to the photo's pose and calibration."""
    reader = BagReader(bag)
    messages = list(reader.messages(["/ridge/phone/image_raw/compressed"]))
    images = [reader.decode(message) for message in messages]
    stamps = [stamp for stamp, *_ in imported(bag)]
    assert [message.log_time_ns for message in messages] == [stamp_of(image) for image in images] == stamps
    assert {image.header.frame_id for image in images} == {"phone_optical"}
    return images


def test_a_phone_photo_is_placed_by_its_exif(tmp_path: Path, site: Site) -> None:
    file = save(tmp_path / "a.jpg", phone())
    report = import_photos([file], tmp_path / "bag", site=site, assumed=LEVEL)
    ((stamp, camera, pose, _),), (image,) = imported(tmp_path / "bag"), images_of(tmp_path / "bag")
    assert stamp == 1_720_143_015 * 10**9  # 2024-07-05 01:30:15 UTC
    assert camera == Camera(W, H, FX, FX, (W - 1) / 2, (H - 1) / 2)
    x, y = site.frame.from_lonlat(LON, LAT)
    np.testing.assert_allclose(pose.position, [x, y, GROUND + 12.0], atol=1e-6)
    # True north turns to grid north by the meridian convergence, here -0.6 deg: sin(lat) * (lon - central meridian).
    convergence = np.sin(np.radians(LAT)) * (LON + 117.0)
    np.testing.assert_allclose(pose.angles_deg, [90.0 - convergence, 0.0, 0.0], atol=0.01)
    assert bytes(image.data) == file.read_bytes()
    assert image.format == "jpeg"
    assert any("pitch is unknown (EXIF has none): 0 +- 3 deg is assumed" in note for _, note in report.notes)
    assert report.cameras == {"phone": 1}


def test_a_compass_direction_is_turned_by_the_declination_of_its_day(tmp_path: Path, site: Site) -> None:
    save(tmp_path / "true.jpg", phone())
    save(tmp_path / "magnetic.jpg", phone(gps_16="M", **{"photo_0x9003": "2024:07:04 18:30:16"}))
    import_photos([tmp_path / "true.jpg", tmp_path / "magnetic.jpg"], tmp_path / "bag", site=site, assumed=LEVEL)
    (_, _, true, _), (_, _, magnetic, _) = imported(tmp_path / "bag")
    turned = (magnetic.angles_deg[0] - true.angles_deg[0]) % 360
    assert turned == pytest.approx(magnetic_declination_deg(LON, LAT, date(2024, 7, 5), GROUND + 12), abs=0.01)
    assert 11.0 < turned < 12.0  # Los Angeles in 2024, by NOAA's chart


@pytest.mark.parametrize(("suffix", "orientation", "turns"), [("jpg", 6, 3), ("png", 3, 2), ("heic", 8, 1)])
def test_photos_taken_upright_are_turned(tmp_path: Path, site: Site, suffix: str, orientation: int, turns: int) -> None:
    """Orientation 6: the 0th row is the right-hand side, so the pixels turn clockwise to stand upright."""
    file = save(tmp_path / f"a.{suffix}", phone(**{"main_0x0112": orientation}))
    upright = np.rot90(picture(), turns)
    photo = read_photo(file)
    assert (photo.height, photo.width) == upright.shape[:2]
    import_photos([file], tmp_path / "bag", site=site, assumed=LEVEL)
    ((_, camera, _, _),), (image,) = imported(tmp_path / "bag"), images_of(tmp_path / "bag")
    assert (camera.height, camera.width) == upright.shape[:2]
    assert camera.fx == FX
    assert np.abs(compressed_to_rgb(image).astype(int) - upright).mean() < 6


@pytest.mark.parametrize(
    ("altitude", "expected", "note"),
    [
        (GROUND + 12.0, GROUND + 12.0, None),
        (GROUND - 30.0, GROUND + 1.75, "30.0 m under the terrain"),
        (GROUND + 45.0, GROUND + 45.0, "45.0 m above the terrain"),
        (None, GROUND + 1.75, "height is unknown"),
    ],
)
def test_heights(tmp_path: Path, site: Site, altitude: float | None, expected: float, note: str | None) -> None:
    save(tmp_path / "a.jpg", phone(gps_6=altitude))
    report = import_photos(
        [tmp_path / "a.jpg"], tmp_path / "bag", site=site, assumed=Assumptions(0.0, height_above_ground=1.75)
    )
    ((_, _, pose, _),) = imported(tmp_path / "bag")
    assert pose.position[2] == pytest.approx(expected, abs=0.01)
    notes = [text for _, text in report.notes if not text.startswith(("pitch", "roll"))]
    assert (len(notes) == 1 and note in notes[0]) if note else not notes


def test_a_pose_file_goes_before_exif_and_chooses_the_photos(tmp_path: Path, site: Site) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for i, name in enumerate(["a.jpg", "b.jpg", "c.jpg"]):
        save(folder / name, phone(**{"photo_0x9003": f"2024:07:04 18:30:{10 + i}"}))
    (folder / "notes.txt").write_text("not a photo")
    (tmp_path / "poses.csv").write_text(
        "name,x,y,z,azimuth_deg,pitch_deg,roll_deg,fx,fy,cx,cy,k1,k2,p1,p2,k3,stamp\n"
        f"c.jpg,{X0 + 125.5},{Y0 + 740},1777.5,230.77,-5.79,-0.77,61,62,30,21,-0.1,0.02,0.001,0.002,0.03,"
        "2013-08-25T11:04:17.5+02:00\n"
        "a.jpg,,,,12,,,,,,,,,,,,\n"
    )
    report = import_photos([folder], tmp_path / "bag", tmp_path / "poses.csv", site, assumed=LEVEL)
    (early, camera, pose, _), (_, _, by_exif, _) = imported(tmp_path / "bag")
    assert early == 1_377_421_457_500_000_000
    assert camera == Camera(W, H, 61, 62, 30, 21, (-0.1, 0.02, 0.001, 0.002, 0.03))
    np.testing.assert_allclose(pose.position, [125.5, 740.0, 1777.5], atol=1e-9)
    np.testing.assert_allclose(pose.angles_deg, [230.77, -5.79, -0.77], atol=1e-9)
    assert by_exif.angles_deg[0] == pytest.approx(12.0)
    assert by_exif.position[2] == GROUND + 12.0
    assert [file.path.name for file in report.skipped] == ["notes.txt", "b.jpg"]


def test_a_stated_place_outside_the_dem_is_rejected_even_with_its_height(tmp_path: Path, site: Site) -> None:
    save(tmp_path / "a.jpg", phone())
    (tmp_path / "poses.csv").write_text(f"name,x,y,z,azimuth_deg\na.jpg,{Y0},{X0},1777,12\n")
    with pytest.raises(PoseError, match="outside the DEM"):
        import_photos([tmp_path / "a.jpg"], tmp_path / "bag", tmp_path / "poses.csv", site, assumed=LEVEL)


def test_two_cameras_by_column_and_bursts_kept_apart(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        save(tmp_path / name, phone())
    (tmp_path / "poses.csv").write_text("name,camera\na.jpg,east\nb.jpg,east\nc.jpg,west\n")
    files = [tmp_path / name for name in ("a.jpg", "b.jpg", "c.jpg")]
    report = import_photos(files, tmp_path / "bag", tmp_path / "poses.csv", assumed=LEVEL)
    assert report.cameras == {"east": 2, "west": 1}
    reader = BagReader(tmp_path / "bag")
    stamps = [m.log_time_ns for m in reader.messages(topics=["/site/east/pose"])]
    assert stamps[1] - stamps[0] == 1_000_000
    (west,) = reader.messages(topics=["/site/west/pose"])
    assert west.log_time_ns == stamps[0]
    assert any("moved by 1 ms" in note for _, note in report.notes)


def test_without_a_site_the_frame_is_the_utm_zone(tmp_path: Path) -> None:
    report = import_photos([save(tmp_path / "a.jpg", phone())], tmp_path / "bag", assumed=LEVEL)
    assert (report.crs, report.origin) == ("EPSG:32611", (402_000.0, 3_788_000.0))
    ((_, _, pose, _),) = imported(tmp_path / "bag", "camera", "site")
    x, y = SiteFrame("EPSG:32611").from_lonlat(LON, LAT)
    np.testing.assert_allclose(pose.position[:2], [float(x) - 402_000, float(y) - 3_788_000], atol=1e-6)
    info = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert info["custom_data"]["ltm_crs"] == "EPSG:32611"
    assert info["custom_data"]["ltm_origin"] == "402000.0 3788000.0"


@pytest.mark.parametrize(
    ("changes", "error", "complaint"),
    [
        ({"gps_2": None}, PoseError, "no position in EXIF"),
        ({"gps_17": None}, PoseError, "no direction in EXIF"),
        ({"photo_0xA405": None}, CameraError, "no focal length|does not give the focal length"),
        ({"photo_0xA405": None, "photo_0x920A": 6.86}, CameraError, "--focal-35mm"),
        ({"photo_0x9003": None}, RecordingError, "has no date"),
        ({"photo_0x9003": "1969:07:04 18:30:15"}, RecordingError, "before 1970"),
        ({"gps_2": (35.0, 0.0, 0.0), "gps_6": None}, PoseError, "outside the DEM"),
        ({"gps_2": (34.0, 14.0, 30.0)}, PoseError, "outside the DEM"),
        ({"gps_3": None}, PoseError, "GPSLongitudeRef"),
        ({"gps_18": "TOKYO"}, PoseError, "TOKYO"),
        ({"gps_2": (91.0, 0.0, 0.0)}, ImageError, "invalid EXIF position"),
        ({"gps_4": (181.0, 0.0, 0.0)}, ImageError, "invalid EXIF position"),
    ],
)
def test_photos_that_cannot_be_placed_are_named_and_no_bag_is_begun(
    tmp_path: Path, site: Site, changes: dict[str, Any], error: type[LtmError], complaint: str
) -> None:
    save(tmp_path / "bad.jpg", phone(**changes))
    good = save(tmp_path / "good.jpg", phone())
    with pytest.raises(error, match=rf"bad\.jpg.*({complaint})"):
        import_photos([good, tmp_path / "bad.jpg"], tmp_path / "bag", site=site, assumed=LEVEL)
    assert not (tmp_path / "bag").exists()
    report = import_photos([good, tmp_path / "bad.jpg"], tmp_path / "bag", site=site, assumed=LEVEL, skip_bad=True)
    assert [path.name for path, _ in report.rejected] == ["bad.jpg"]
    assert len(imported(tmp_path / "bag")) == 1


def test_a_file_that_is_no_photo_is_refused(tmp_path: Path) -> None:
    Image.fromarray(picture()).save(tmp_path / "a.png", "GIF")
    with pytest.raises(ImageError, match=r"a\.png is GIF"):
        read_photo(tmp_path / "a.png")


def test_an_unknown_pitch_is_refused_and_never_taken_as_level(tmp_path: Path, site: Site) -> None:
    file = save(tmp_path / "a.jpg", phone())
    with pytest.raises(PoseError, match=r"a\.jpg: its pitch is unknown .*pitch_deg in a pose file.*--pitch-deg"):
        import_photos([file], tmp_path / "bag", site=site)
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(("stated", "sigma"), [(4.75, 4.75), (None, 5.0)])
def test_a_phones_pose_is_as_sure_as_its_sensors(
    tmp_path: Path, site: Site, stated: float | None, sigma: float
) -> None:
    file = save(tmp_path / "a.jpg", phone(gps_31=stated))
    import_photos([file], tmp_path / "bag", site=site, assumed=Assumptions(-4.0))
    ((_, _, pose, covariance),) = imported(tmp_path / "bag")
    np.testing.assert_allclose(covariance, pose_covariance(pose, sigma, 10.0, 8.2, 3.0, 3.0), atol=1e-12)
    assert np.degrees(np.sqrt(covariance[5, 5])) > 8


def test_what_a_row_states_is_as_sure_as_the_site_assumes_or_as_it_says(tmp_path: Path, site: Site) -> None:
    file = save(tmp_path / "a.jpg", phone())
    rows = tmp_path / "poses.csv"
    whole = f"{X0 + 100},{Y0 + 700},1777,230,-5,0.5"
    rows.write_text(f"name,x,y,z,azimuth_deg,pitch_deg,roll_deg\na.jpg,{whole}\n")
    import_photos([file], tmp_path / "bag", rows, site)
    assert imported(tmp_path / "bag")[0][3] is None
    rows.write_text(f"name,x,y,z,azimuth_deg,pitch_deg,roll_deg,azimuth_sigma_deg\na.jpg,{whole},1.5\n")
    import_photos([file], tmp_path / "sure", rows, site)
    ((_, _, pose, found),) = imported(tmp_path / "sure")
    np.testing.assert_allclose(found, pose_covariance(pose, 0.5, 0.5, 1.5, 0.3, 0.3), atol=1e-12)
    rows.write_text("name,azimuth_deg,pitch_deg,roll_deg\na.jpg,230,-5,0.5\n")
    import_photos([file], tmp_path / "mixed", rows, site)
    ((_, _, pose, found),) = imported(tmp_path / "mixed")
    np.testing.assert_allclose(found, pose_covariance(pose, 5.0, 10.0, 0.3, 0.3, 0.3), atol=1e-12)


def fixed(tmp_path: Path, **calibration: Any) -> Site:
    """The site with a camera of stated pose and calibration."""
    document = yaml.safe_load((tmp_path / "site.yaml").read_text())
    pose = {
        "x": X0 + 110.0,
        "y": Y0 + 720.0,
        "z": 1600.0,
        "azimuth_deg": 75.0,
        "pitch_deg": -6.0,
        "position_sigma": 2.0,
    }
    lens = {"width": W, "height": H, "hfov_deg": 50.0, "k1": -0.05}
    document["cameras"] = {"phone": {"pose": pose, "calibration": lens | calibration}}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(document))
    return load_site(tmp_path / "site.yaml")


def test_a_fixed_cameras_pose_and_calibration_come_from_the_site_file(tmp_path: Path, site: Site) -> None:
    tower = fixed(tmp_path)
    bare = save(tmp_path / "a.jpg", {"main": {}, "photo": {0x9003: "2024:07:04 18:30:15", 0x9011: "-07:00"}, "gps": {}})
    import_photos([bare], tmp_path / "bag", site=tower)
    ((_, camera, pose, found),) = imported(tmp_path / "bag")
    np.testing.assert_allclose(pose.position, [110.0, 720.0, 1600.0], atol=1e-9)
    np.testing.assert_allclose(pose.angles_deg, [75.0, -6.0, 0.0], atol=1e-9)
    assert camera == tower.camera("phone").calibration.camera()
    np.testing.assert_allclose(found, pose_covariance(pose, 2.0, 0.5, 0.3, 0.3, 0.3), atol=1e-12)
    # A row goes before it, EXIF does not.
    rows = tmp_path / "poses.csv"
    rows.write_text("name,azimuth_deg\nb.jpg,80\n")
    import_photos([save(tmp_path / "b.jpg", phone())], tmp_path / "row", rows, tower)
    ((_, _, pose, _),) = imported(tmp_path / "row")
    np.testing.assert_allclose(pose.angles_deg, [80.0, -6.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(pose.position, [110.0, 720.0, 1600.0], atol=1e-9)


def test_a_photo_above_the_sites_limit_is_rejected_at_import(tmp_path: Path, site: Site) -> None:
    """Replay would reject it, and leave an empty bag."""
    document = yaml.safe_load((tmp_path / "site.yaml").read_text()) | {"expert": {"limits": {"pixels": W * H - 1}}}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(ImageError, match=str(W * H - 1)):
        import_photos(
            [save(tmp_path / "a.jpg", phone())], tmp_path / "bag", site=load_site(tmp_path / "site.yaml"), assumed=LEVEL
        )
    assert not (tmp_path / "bag").exists()
