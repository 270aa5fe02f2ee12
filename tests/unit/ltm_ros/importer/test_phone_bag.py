"""The walk in bags/phone: what its photos and its recording say, against where they were taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.phone_site import imported

from ltm_core.resources import project_path
from ltm_core.site_io import load_site
from ltm_core.types import Float64Array
from ltm_ros.importer.assumptions import Assumptions
from ltm_ros.importer.build import import_photos

WALK = project_path("bags/phone")


def off(bag: Path, true: Path) -> Float64Array:
    """(N, 6): east, north, up in metres, azimuth, pitch, roll in degrees."""
    rows = []
    for (_, camera, found, _), (_, same, pose, _) in zip(
        imported(bag, site="phone_walk"), imported(true, site="phone_walk"), strict=True
    ):
        assert (camera.width, camera.height) == (same.width, same.height)
        assert camera.fx == pytest.approx(same.fx, rel=2e-3)
        turns = np.subtract(found.angles_deg, pose.angles_deg)
        rows.append([*(found.position - pose.position), *((turns + 180) % 360 - 180)])
    return np.array(rows)


def test_the_recording_errs_as_a_phone_does(tmp_path: Path) -> None:
    site = load_site(WALK / "site.yaml")
    import_photos([WALK / "photos"], tmp_path / "true", WALK / "true_poses.csv", site)
    lens = Assumptions(focal_35mm=26.0, height_above_ground=1.6)
    report = import_photos([WALK / "sensor_logger.zip"], tmp_path / "log", site=site, assumed=lens)
    assert report.cameras == {"phone": 24}
    assert not report.notes
    errors = off(tmp_path / "log", tmp_path / "true")
    mean, spread = errors.mean(axis=0), errors.std(axis=0)
    assert np.hypot(*mean[:2]) < 3 * 5.0  # GPS
    assert np.abs(mean[2]) < 1.5  # the barometer's 4 m are gone: heights count from the ground
    assert np.abs(mean[3]) < 3 * 6.0  # a compass, off alike in all photos
    assert spread[3] == pytest.approx(1.5, abs=0.6)
    assert (np.abs(mean[4:]) < 0.5).all()
    np.testing.assert_allclose(spread[4:], 0.7, atol=0.25)
    sizes = {(camera.width, camera.height) for _, camera, _, _ in imported(tmp_path / "log", site="phone_walk")}
    assert sizes == {(1024, 768), (768, 1024)}


def test_it_stays_small() -> None:
    assert sum(path.stat().st_size for path in WALK.rglob("*") if path.is_file()) < 8_000_000
