from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.phone_site import FRAME, imported, phone_site, taken

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.pose import Pose, pose_covariance, pose_sigmas
from ltm_lab.simulator.sensor_logger_io import write_sensor_logger
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.importing.photo import read_pose_file

WALK = [taken(0, (231.0, -3.5, 1.25)), taken(1, (118.0, 4.0, -2.0), at=(9.0, 3.0, 0.7), portrait=True)]
LENS = Assumptions(focal_35mm=27.0, height_above_ground=1.6, keep_unknown=True)


@pytest.mark.parametrize("pitch", [-70.0, -4.0, 35.0])
def test_sigmas_come_back_from_a_covariance(pitch: float) -> None:
    pose = Pose.from_angles((1.0, 2.0, 3.0), 217.0, pitch, 12.0)
    sigmas = pose_sigmas(pose, pose_covariance(pose, 4.0, 7.0, 8.2, 1.0, 2.5))
    np.testing.assert_allclose(sigmas, [4.0, 4.0, 7.0, 8.2, 1.0, 2.5], rtol=1e-9)


def test_a_folder_of_pose_files_places_the_photos_that_it_names(tmp_path: Path) -> None:
    """As `ltm pose photo` leaves it, one a photo; the recording keeps the time."""
    site = phone_site(tmp_path)
    write_sensor_logger(tmp_path / "walk.zip", WALK, FRAME, 90, -35.4)
    folder = tmp_path / "found"
    folder.mkdir()
    x, y, z = (float(v) for v in WALK[1].pose.position)
    found = {
        "pose": {"x": x + 402_000.0, "y": y + 3_787_000.0, "z": z, "crs": "EPSG:32611", "azimuth_deg": 112.5},
        "calibration": {"width": 40, "height": 64, "fx": 47.0, "fy": 47.0, "cx": 19.5, "cy": 31.5},
        "curvature": True,
        "refraction": 0.13,
    }
    found["pose"] |= {"pitch_deg": 3.25, "roll_deg": -1.5, "azimuth_sigma_deg": 0.3}
    (folder / f"{WALK[1].stamp_ns // 1_000_000}.yaml").write_text(yaml.safe_dump(found))
    report = import_photos([tmp_path / "walk.zip"], tmp_path / "bag", folder, site, assumed=LENS)
    assert [file.path.name for file in report.skipped] == [f"{WALK[0].stamp_ns // 1_000_000}.jpg"]
    ((stamp, camera, pose, covariance),) = imported(tmp_path / "bag")
    assert (stamp, camera.fx) == (WALK[1].stamp_ns, 47.0)
    np.testing.assert_allclose(pose.angles_deg, [112.5, 3.25, -1.5], atol=1e-9)
    assert pose_sigmas(pose, covariance)[3] == pytest.approx(0.3)
    (folder / "other.yaml").write_text("camera: 3\n")
    with pytest.raises(ConfigError, match=r"other\.yaml is not a pose file"):
        import_photos([tmp_path / "walk.zip"], tmp_path / "again", folder, site, assumed=LENS)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="contains no pose files"):
        read_pose_file(tmp_path / "empty")
