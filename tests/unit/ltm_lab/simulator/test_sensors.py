"""What a camera reports of its pose, and how it errs."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.camera_setup import PHONE, SensorConfig
from ltm_lab.simulator.sensors import SensorModel


def test_a_phone_errs_as_it_says() -> None:
    pose = Pose.from_angles((10.0, 20.0, 300.0), 200.0, -5.0, 1.0)
    errors = []
    for k in range(300):
        report = SensorModel(PHONE.model_copy(update={"lost": 0.0}), f"phone{k}", 5).report(pose, 1_000_000_000_000)
        assert report is not None
        azimuth, pitch, _ = report.pose.angles_deg
        errors.append([*(report.pose.position - pose.position), (azimuth - 200 + 180) % 360 - 180, pitch + 5.0])
        assert report.stamp_ns == 1_000_250_000_000
        assert report.received_ns >= 1_000_000_000_000
        covariance = report.covariance
    spread = np.std(errors, axis=0)
    np.testing.assert_allclose(spread, np.array([5.1, 5.1, 4.03, 6.18, 0.7]), rtol=0.15)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance))[:3], np.array([5.1, 5.1, 4.03]), rtol=0.01)


def test_constant_errors_stay_and_frames_get_lost_or_late() -> None:
    pose = Pose.from_angles((10.0, 20.0, 300.0), 200.0, -5.0)
    model = SensorModel(SensorConfig(compass_bias_deg=5.0, lost=0.3, late=0.5, late_s=2.0), "a", 1)
    reports = [model.report(pose, 10**12) for _ in range(400)]
    arrived = [r for r in reports if r is not None]
    assert len(arrived) == pytest.approx(280, abs=30)
    assert len({round(r.pose.angles_deg[0], 6) for r in arrived}) == 1
    delays = np.array([r.received_ns - 10**12 for r in arrived]) / 1e9
    assert 0.4 < np.mean(delays > 0) < 0.6
    assert delays.max() <= 2.0
    exact = SensorModel(SensorConfig(), "a", 1).report(pose, 10**12)
    assert exact is not None
    np.testing.assert_allclose(exact.pose.rotation, pose.rotation, atol=1e-12)
    assert not exact.covariance.any()
