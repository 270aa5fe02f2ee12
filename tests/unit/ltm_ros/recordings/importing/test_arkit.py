from __future__ import annotations

import json
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from scenes.movie_file import jpeg, movie
from scenes.phone_site import FRAME, GROUND, LAT, LON, imported, phone_site, picture
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import PoseError, RecordingError
from ltm_core.base.types import Float64Array
from ltm_core.cameras.sensor_pose import ENU_FROM_EUS, OPENGL_FROM_OPTICAL
from ltm_core.geometry.pose import Pose
from ltm_core.site.site import Site
from ltm_ros.recordings.importing.build import import_photos

HEAD = "timestamp, frame, x, y, z, qx, qy, qz, qw"
BEGIN = datetime(2024, 7, 5, 1, 30, 15, tzinfo=UTC)
STARTED = 77.0
"""Degrees by which the app's world is turned from ours: where the phone looked when it was started."""
WALK = [Pose.from_angles((0.0, 0.0, 0.0), 231.0, -4.0, 1.0), Pose.from_angles((3.0, -2.0, 0.5), 250.0, 6.0, -2.0)]
"""From the first frame's place, a second apart."""


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return phone_site(tmp_path)


def local(pose: Pose) -> tuple[Float64Array, Float64Array]:
    """Rotation of OpenCV's camera axes and position in ARKit's world of y up, turned by STARTED."""
    turn = ENU_FROM_EUS.T @ Rotation.from_euler("z", STARTED, degrees=True).as_matrix()
    return turn @ pose.rotation, turn @ pose.position


def stray(folder: Path, portrait: bool = False, **changes: str | None) -> Path:
    """A scan: the sensor's rows lie along the screen, so a portrait is stored on its side."""
    folder.mkdir()
    rows = [HEAD]
    for k, pose in enumerate(WALK):
        stored = pose.rotation
        if portrait:  # its top lies to the left of the stored image
            stored = stored @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        rotation, position = local(Pose(pose.position, stored))
        quaternion = Rotation.from_matrix(rotation).as_quat()
        rows.append(", ".join([f"{812.5 + k:.6f}", f"{k:06d}", *(f"{v:.9f}" for v in (*position, *quaternion))]))
    files: dict[str, str | bytes | None] = {
        "odometry.csv": "\n".join(rows) + "\n",
        "camera_matrix.csv": "52.0,0.0,31.0\n0.0,51.0,21.0\n0.0,0.0,1.0\n",
        "imu.csv": "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n",
        **changes,
    }
    for name, text in files.items():
        if text is not None:
            (folder / name).write_text(str(text))
    (folder / "rgb.mp4").write_bytes(movie([picture(), picture()], 1, BEGIN))
    return folder


def poses(tmp_path: Path, name: str, more: str = "", columns: str = "") -> Path:
    path = tmp_path / "poses.csv"
    path.write_text(
        f"name,lon,lat,height_above_ground,azimuth_deg,azimuth_sigma_deg{columns}\n{name},{LON},{LAT},1.6,231,2{more}\n"
    )
    return path


def expected(place: Pose) -> Pose:
    x, y = (float(v) for v in FRAME.from_lonlat(LON, LAT))
    return Pose(np.array([x, y, GROUND + 1.6]) + place.position, place.rotation)


def test_a_scan_is_placed_by_its_first_frame(tmp_path: Path, site: Site) -> None:
    """Whichever way the app's world was turned; pitch and roll are its own."""
    scan = stray(tmp_path / "scan1")
    import_photos([scan], tmp_path / "bag", poses(tmp_path, "scan1"), site)
    rows = imported(tmp_path / "bag")
    assert [stamp for stamp, *_ in rows] == [1_720_143_015_000_000_000, 1_720_143_016_000_000_000]
    for pose, (_, camera, found, _) in zip(WALK, rows, strict=True):
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (52.0, 51.0, 31.0, 21.0)
        np.testing.assert_allclose(found.position, expected(pose).position, atol=0.02)
        np.testing.assert_allclose(found.rotation, pose.rotation, atol=1e-5)
    # Its heading's sigma of 2 degrees moves the second frame sideways: 3.6 m from the first, 3 m of them east.
    extra = np.sqrt(rows[1][3][1, 1] - rows[0][3][1, 1])
    assert extra == pytest.approx(np.radians(2.0) * 3.0, rel=0.05)


def test_a_portrait_is_turned_upright_with_its_lens(tmp_path: Path, site: Site) -> None:
    scan = stray(tmp_path / "scan1", portrait=True)
    import_photos([scan], tmp_path / "bag", poses(tmp_path, "scan1"), site)
    for pose, (_, camera, found, _) in zip(WALK, imported(tmp_path / "bag"), strict=True):
        assert (camera.width, camera.height) == (40, 64)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (51.0, 52.0, 39 - 21.0, 31.0)
        np.testing.assert_allclose(found.rotation, pose.rotation, atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"odometry.csv": "timestamp, frame, x\n1, 0, 2\n"}, "odometry.csv has no column qw"),
        ({"odometry.csv": HEAD + "\n1, 0, 0, 0, 0, a, 0, 0, 1\n"}, "contains an invalid number"),
        ({"odometry.csv": HEAD + "\n1, 0, 0, 0, 0, 0, 0, 0, 0\n"}, "must have a norm of 1"),
        ({"odometry.csv": HEAD + "\n"}, "has 0 rows"),
        ({"camera_matrix.csv": "1,2\n"}, "is not a 3 x 3 matrix"),
        ({"camera_matrix.csv": None}, r"no camera_matrix\.csv, and no fx"),
        ({"camera_matrix.csv": "-5,0,1\n0,5,1\n0,0,1\n"}, "must be positive"),
    ],
)
def test_scans_that_are_broken_are_told(
    tmp_path: Path, site: Site, changes: dict[str, str | None], complaint: str
) -> None:
    scan = stray(tmp_path / "scan1", **changes)
    with pytest.raises(RecordingError, match=complaint):
        import_photos([scan], tmp_path / "bag", poses(tmp_path, "scan1"), site)


def record3d(path: Path, **changes: object) -> Path:
    """An .r3d file: poses as from the first frame, of OpenGL's axes; K by columns."""
    first = WALK[0]
    rows = []
    for pose in WALK:
        # The world is the first camera's own, axes as OpenGL has them.
        rotation = OPENGL_FROM_OPTICAL.T @ first.rotation.T @ pose.rotation @ OPENGL_FROM_OPTICAL
        position = OPENGL_FROM_OPTICAL.T @ first.rotation.T @ (pose.position - first.position)
        rows.append([*Rotation.from_matrix(rotation).as_quat(), *position])
    facts = {"w": 64, "h": 40, "fps": 1, "K": [52.0, 0, 0, 0, 51.0, 0, 31.0, 21.0, 1], "poses": rows, **changes}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps({key: v for key, v in facts.items() if v is not None}))
        for k in range(len(WALK)):
            archive.writestr(f"rgbd/{k}.jpg", jpeg(picture()))
            archive.writestr(f"rgbd/{k}.depth", b"")
    return path


def test_a_record3d_capture_needs_the_first_frames_whole_pose(tmp_path: Path, site: Site) -> None:
    """Its world is the first camera's: not even gravity is known."""
    path = record3d(tmp_path / "tree.r3d")
    stamp = ",2024-07-05T01:30:15Z"
    with pytest.raises(PoseError, match="pitch is unknown"):
        import_photos([path], tmp_path / "bag", poses(tmp_path, "tree.r3d", stamp, ",stamp"), site)
    rows = poses(tmp_path, "tree.r3d", stamp + ",-4,1", ",stamp,pitch_deg,roll_deg")
    import_photos([path], tmp_path / "bag", rows, site)
    for k, (pose, (stamp_ns, camera, found, _)) in enumerate(zip(WALK, imported(tmp_path / "bag"), strict=True)):
        assert stamp_ns == 1_720_143_015_000_000_000 + k * 10**9
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (52.0, 51.0, 31.0, 21.0)
        np.testing.assert_allclose(found.position, expected(pose).position, atol=0.02)
        np.testing.assert_allclose(found.rotation, pose.rotation, atol=1e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"poses": None},
        {"poses": [[1, 2, 3]]},
        {"poses": []},
        {"K": [1, 2]},
        {"fps": -1},
        {"poses": [[0, 0, 0, 0, 1, 2, 3]]},
        {"perFrameIntrinsicCoeffs": [[1, 2, 3]]},
    ],
)
def test_record3d_metadata_that_is_none_is_told(tmp_path: Path, site: Site, changes: dict[str, object]) -> None:
    path = record3d(tmp_path / "tree.r3d", **changes)
    with pytest.raises(RecordingError, match=r"tree\.r3d: 'metadata'"):
        import_photos([path], tmp_path / "bag", site=site)
