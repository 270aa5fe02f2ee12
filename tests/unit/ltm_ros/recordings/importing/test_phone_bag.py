from pathlib import Path

import numpy as np
import pytest
from scenes.phone_site import imported

from ltm_core.base.resources import project_path
from ltm_core.geometry.pose import pose_sigmas
from ltm_core.site.site_io import load_site
from ltm_ros.recordings.importing.build import import_photos

WALK = project_path("bags/phone")


def test_the_recording_errs_as_a_phone_does(tmp_path: Path) -> None:
    site = load_site(WALK / "site.yaml")
    import_photos([WALK / "photos"], tmp_path / "true", WALK / "true_poses.csv", site)
    told, true = (imported(bag, site="phone_walk") for bag in (WALK / "recording", tmp_path / "true"))
    assert [row[0] for row in told] == [row[0] for row in true]
    sigmas = [pose_sigmas(pose, covariance)[2:] for _, _, pose, covariance in told]
    np.testing.assert_allclose(sigmas, np.tile([2**0.5, 8.2, 1.0, 1.0], (24, 1)), atol=1e-6)
    poses, others = (np.array([(*pose.position, *pose.angles_deg) for _, _, pose, _ in rows]) for rows in (told, true))
    errors = poses - others
    errors[:, 3:] = (errors[:, 3:] + 180) % 360 - 180
    mean, spread = errors.mean(axis=0), errors.std(axis=0)
    assert np.hypot(*mean[:2]) < 3 * 5.0  # GPS
    assert np.abs(mean[2]) < 1.5  # the barometer's 4 m are gone: heights count from the ground
    assert np.abs(mean[3]) < 3 * 6.0  # a compass, off alike in all photos
    assert spread[3] == pytest.approx(1.5, abs=0.6)
    assert (np.abs(mean[4:]) < 0.5).all()
    np.testing.assert_allclose(spread[4:], 0.7, atol=0.25)
    assert {(camera.width, camera.height) for _, camera, _, _ in told} == {(1024, 768), (768, 1024)}
    for (_, camera, _, _), (_, same, _, _) in zip(told, true, strict=True):
        assert (camera.width, camera.height) == (same.width, same.height)
        assert camera.fx == pytest.approx(same.fx, rel=2e-3)
