import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.camera_setup import PHONE, WalkConfig
from ltm_lab.simulator.terrain_synthesis import HeightField
from ltm_lab.simulator.viewpoints import SensorModel, walk_photos

SLOPE = HeightField(np.tile(np.arange(40, dtype=np.float32) * 2.0, (30, 1)), GridGeometry(0.0, 300.0, 10.0, 40, 30))
"""Rising eastward by a fifth: 2 m each 10 m, 0 at x = 5."""


def walk(**changes: object) -> WalkConfig:
    facts = {
        "name": "phone",
        "path": [(20, 30), (60, 30), (60, 100)],
        "stops": 4,
        "azimuth_deg": [10.0, 200.0],
        **changes,
    }
    return WalkConfig.model_validate(facts)


def test_photos_are_taken_at_eye_height_in_turn() -> None:
    photos = walk_photos(walk(sway_deg=0.0, pitch_deg=[-3.0, -5.0, -7.0]), SLOPE, 3)
    assert len(photos) == 12
    for number, (_, pose, portrait) in enumerate(photos):
        x, y, z = pose.position
        assert z == pytest.approx(float(SLOPE.at(x, y)) + 1.6)
        assert pose.angles_deg == pytest.approx(([10.0, 200.0][number % 2], [-3.0, -5.0, -7.0][number % 3], 0.0))
        assert portrait == bool(number % 2)
    seconds = [second for second, _, _ in photos]
    assert seconds[1] - seconds[0] == 6.0
    assert seconds[3] - seconds[0] == pytest.approx(110 / 3 / 1.2 + 18.0)


def test_a_phone_errs_as_it_says() -> None:
    pose = Pose.from_angles((10.0, 20.0, 300.0), 200.0, -5.0, 1.0)
    errors = []
    for k in range(300):
        report = SensorModel(PHONE, f"phone{k}", 5).report(pose, 1_000_000_000_000)
        azimuth, pitch, _ = report.pose.angles_deg
        errors.append([*(report.pose.position - pose.position), (azimuth - 200 + 180) % 360 - 180, pitch + 5.0])
        assert report.stamp_ns == 1_000_250_000_000
        assert report.received_ns == 1_000_000_000_000
        covariance = report.covariance
    spread = np.std(errors, axis=0)
    np.testing.assert_allclose(spread, np.array([5.1, 5.1, 4.03, 6.18, 0.7]), rtol=0.15)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance))[:3], np.array([5.1, 5.1, 4.03]), rtol=0.01)
