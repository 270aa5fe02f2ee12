from __future__ import annotations

import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from scenes.movie_file import movie
from scenes.phone_site import FRAME, FX, GROUND, LAT, LON, STAMP, imported, phone_site, picture, taken

from ltm_core.base.errors import CameraError, PoseError, RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, pose_covariance
from ltm_core.site.site import Site
from ltm_lab.simulator.sensor_logger_io import write_sensor_logger
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos

BEGIN = datetime(2024, 7, 5, 1, 30, 15, tzinfo=UTC)
BEGIN_NS = 1_720_143_015_000_000_000
HERE = "+34.2250-118.0600/"
KEPT = Assumptions(focal_35mm=27.0, keep_unknown=True)


def frames(count: int = 4) -> list[UInt8Array]:
    """Each a little brighter."""
    return [np.clip(picture().astype(int) + 20 * k, 0, 255).astype(np.uint8) for k in range(count)]


def images(bag: Path) -> list[UInt8Array]:
    reader = BagReader(bag)
    messages = reader.messages(topics=["/ridge/phone/image_raw/compressed"])
    return [compressed_to_rgb(reader.decode(message)) for message in messages]


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return phone_site(tmp_path)


def test_a_phones_video_has_one_place_and_no_direction(tmp_path: Path, site: Site) -> None:
    path = tmp_path / "clip.mp4"
    path.write_bytes(movie(frames(), 2, BEGIN, location=f"+{LAT:.4f}{LON:.4f}+{GROUND + 9:.3f}/"))
    with pytest.raises(PoseError, match=r"clip_0000000\.jpg has no direction in the video's tags.*--refine"):
        import_photos([path], tmp_path / "bag", site=site, assumed=Assumptions(focal_35mm=27.0))
    import_photos([path], tmp_path / "bag", site=site, assumed=KEPT)
    rows = imported(tmp_path / "bag")
    assert [stamp for stamp, *_ in rows] == [BEGIN_NS, BEGIN_NS + 1_000_000_000]  # every second frame: one a second
    for _, camera, pose, covariance in rows:
        assert (camera.width, camera.height, camera.fx) == (64, 40, FX)
        np.testing.assert_allclose(pose.position, [*FRAME.from_lonlat(LON, LAT), GROUND + 9], atol=0.05)
        expected = pose_covariance(pose, 5.0, 10.0, UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, 3.0)
        np.testing.assert_allclose(covariance, expected, atol=1e-9)
    for image, frame in zip(images(tmp_path / "bag"), frames()[::2], strict=True):
        assert np.abs(image.astype(int) - frame).mean() < 3


def test_a_video_that_is_to_be_turned_is_taken_upright(tmp_path: Path, site: Site) -> None:
    path = tmp_path / "clip.mov"
    path.write_bytes(movie(frames(1), 2, BEGIN, location=f"+{LAT:.4f}{LON:.4f}/", turned=90))
    import_photos([path], tmp_path / "bag", site=site, assumed=KEPT)
    ((_, camera, _, _),) = imported(tmp_path / "bag")
    assert (camera.width, camera.height, camera.fx) == (40, 64, FX)
    (image,) = images(tmp_path / "bag")
    assert np.abs(image.astype(int) - np.rot90(frames(1)[0], -1)).mean() < 3


def test_a_recording_of_the_same_time_tells_the_direction(tmp_path: Path, site: Site) -> None:
    walk = [taken(k, (100.0 + 20 * k, -3.0, 1.0)) for k in range(2)]
    write_sensor_logger(tmp_path / "walk.zip", walk, FRAME, 50, -35.4)
    with zipfile.ZipFile(tmp_path / "walk.zip") as old, zipfile.ZipFile(tmp_path / "bare.zip", "w") as new:
        for name in old.namelist():
            if not name.startswith("Camera/"):
                new.writestr(name, old.read(name))
    path = tmp_path / "clip.mp4"
    path.write_bytes(movie(frames(1), 2, BEGIN))
    import_photos([path, tmp_path / "bare.zip"], tmp_path / "bag", site=site, assumed=Assumptions(focal_35mm=27.0))
    ((stamp, _, pose, _),) = imported(tmp_path / "bag")
    assert stamp == BEGIN_NS == STAMP - 250_000_000
    np.testing.assert_allclose(pose.angles_deg, [100.0, -3.0, 1.0], atol=0.01)


@pytest.mark.parametrize(
    ("content", "assumed", "error", "complaint"),
    [
        (movie(frames(1), 2, location=HERE), KEPT, RecordingError, "has no date: give it a `stamp`"),
        (movie(frames(1), 2, BEGIN), KEPT, PoseError, "has no position in the video's tags"),
        (movie(frames(1), 2, BEGIN, location=HERE), Assumptions(keep_unknown=True), CameraError, "--focal-35mm"),
        (movie(frames(1), 2, BEGIN)[:400], KEPT, RecordingError, "cannot be read as a video|no frame"),
        (b"\0\0\0\x18ftypmp42" + bytes(60), KEPT, RecordingError, "cannot be read as a video|without images"),
    ],
)  # fmt: skip
def test_videos_that_tell_too_little_are_told_with_the_remedy(
    tmp_path: Path, site: Site, content: bytes, assumed: Assumptions, error: type[Exception], complaint: str
) -> None:
    (tmp_path / "clip.mp4").write_bytes(content)
    with pytest.raises(error, match=rf"clip.*({complaint})"):
        import_photos([tmp_path / "clip.mp4"], tmp_path / "bag", site=site, assumed=assumed)
    assert not (tmp_path / "bag").exists()
