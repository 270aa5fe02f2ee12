import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scenes.phone_site import FRAME, ORIGIN, imported, phone_site, picture, taken

from ltm_core.geometry.pose import Pose
from ltm_lab.evaluation.phone_capture import write_phone_capture
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos


def frames(folder: Path, walks: list[dict[str, Any]] | None = None) -> list[Pose]:
    """Two frames of a walk as `ltm-lab simulate` leaves them; their true poses."""
    folder.mkdir()
    entries, poses = [], []
    for k, portrait in enumerate((False, True)):
        photo = taken(k, (231.0 - 40 * k, -3.0, 1.0), (9.0 * k, 0.0, 1.6), portrait)
        true = Pose.from_angles(np.add(photo.pose.position, (2.0, -1.0, 1.0)), 236.0 - 40 * k, -2.5, 0.5)
        cv2.imwrite(str(folder / f"{k:04d}.png"), cv2.cvtColor(picture(portrait), cv2.COLOR_RGB2BGR))
        names = ("azimuth_deg", "pitch_deg", "roll_deg")
        reported = {
            "stamp_ns": photo.stamp_ns,
            "position": photo.pose.position.tolist(),
            "covariance": [16.0, 16.0, 9.0, 1e-4, 1e-4, 1e-2],
            **dict(zip(names, photo.pose.angles_deg, strict=True)),
        }
        camera = {key: getattr(photo.camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy", "distortion")}
        entries.append(
            {
                "image": f"{k:04d}.png",
                "camera_name": "phone",
                "stamp_ns": photo.stamp_ns,
                "truth": f"{k:04d}_truth.npz",
                "camera": camera,
                "truth_camera": camera,
                "position": true.position.tolist(),
                "reported": reported,
                **dict(zip(names, true.angles_deg, strict=True)),
            }
        )
        poses.append(true)
    index = {
        "scenario": "walk",
        "curvature": True,
        "crs": FRAME.crs,
        "origin": list(ORIGIN),
        "jpeg_quality": 90,
        "walks": [{"name": "phone", "geoid_undulation": -35.4}] if walks is None else walks,
        "frames": entries,
    }
    (folder / "frames.json").write_text(json.dumps(index))
    return poses


def test_photos_recording_and_truth_of_one_walk(tmp_path: Path) -> None:
    """What the sensors said comes back from photos and recording alike, where it truly was from the list."""
    site = phone_site(tmp_path)
    true = frames(tmp_path / "frames")
    assert write_phone_capture(tmp_path / "frames", tmp_path / "out") == 2
    lens = Assumptions(focal_35mm=27.0, keep_unknown=True)
    sensors = [tmp_path / "out/photos", tmp_path / "out/sensor_logger.zip"]
    import_photos(sensors, tmp_path / "zip", site=site, assumed=lens)
    import_photos([tmp_path / "out/photos"], tmp_path / "exif", site=site, assumed=lens)
    import_photos([tmp_path / "out/photos"], tmp_path / "true", tmp_path / "out/true_poses.csv", site)
    for k, truth in enumerate(true):
        told = taken(k, (231.0 - 40 * k, -3.0, 1.0), (9.0 * k, 0.0, 1.6))
        _, camera, by_log, _ = imported(tmp_path / "zip")[k]
        _, same, by_exif, _ = imported(tmp_path / "exif")[k]
        _, _, by_list, _ = imported(tmp_path / "true")[k]
        assert camera == same
        assert (camera.height > camera.width) == bool(k)
        np.testing.assert_allclose(by_log.angles_deg, told.pose.angles_deg, atol=2e-3)
        assert by_exif.angles_deg[0] == pytest.approx(told.pose.angles_deg[0], abs=1e-3)
        np.testing.assert_allclose(by_list.angles_deg, truth.angles_deg, atol=1e-4)
        np.testing.assert_allclose(by_list.position, truth.position, atol=1e-3)
