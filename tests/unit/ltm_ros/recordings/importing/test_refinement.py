from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image
from scenes.mountain_view import CAMERA, ORIGIN, TRUE, view, write_site
from scenes.phone_site import imported

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import Label
from ltm_ros.recordings.importing import refinement
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.importing.refinement import CompassError


@pytest.fixture(scope="module")
def photo_and_labels() -> tuple[UInt8Array, UInt8Array]:
    return view(TRUE)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return load_site(write_site(tmp_path, name="walk", cameras={"phone": {}}))


def imported_photo(
    site: Site, folder: Path, photo: UInt8Array, labels: UInt8Array, **stated: float
) -> tuple[Pose, np.ndarray | None, str]:
    """Pose and covariance in the bag of one photo, of which `stated` is told; and the verdict."""
    Image.fromarray(photo).save(folder / "a.png")
    x, y, z = TRUE.position
    row = {"name": "a.png", "x": x + ORIGIN[0], "y": y + ORIGIN[1], "z": z, "stamp": "2031-05-03T10:00:00Z"}
    row |= {"width": CAMERA.width, "height": CAMERA.height, "fx": CAMERA.fx} | stated
    (folder / "poses.csv").write_text(",".join(row) + "\n" + ",".join(map(str, row.values())) + "\n")
    network = SimpleNamespace(segment=lambda _: SimpleNamespace(labels=labels))
    assumed = Assumptions(keep_unknown=True)
    files = [folder / "a.png"], folder / "bag", folder / "poses.csv"
    with patch.object(refinement, "site_segmenter", lambda *_: network):
        report = import_photos(*files, site, None, assumed, refinement=refinement.PoseRefinement(site))
    ((_, _, pose, covariance),) = imported(folder / "bag", site="walk")
    ((name, found),) = report.refined
    assert name == "a.png"
    return pose, covariance, found.verdict


def test_the_picture_s_pose_is_written_with_its_covariance(
    site: Site, tmp_path: Path, photo_and_labels: tuple[UInt8Array, UInt8Array]
) -> None:
    photo, labels = photo_and_labels
    stated = {"azimuth_deg": 66.0, "pitch_deg": 1.9, "roll_deg": 0.4, "azimuth_sigma_deg": 3.0}
    pose, covariance, verdict = imported_photo(site, tmp_path, photo, labels, **stated)
    assert verdict == "accepted"
    assert np.degrees(np.abs(angles_between(TRUE, pose))).max() < 0.15
    assert np.degrees(np.sqrt(covariance[5, 5])) < 0.5


@pytest.mark.parametrize("shown", ["fog", "upside down"])
def test_what_shows_no_pose_stays_as_given(
    site: Site, tmp_path: Path, photo_and_labels: tuple[UInt8Array, UInt8Array], shown: str
) -> None:
    photo, labels = photo_and_labels
    fog = np.full_like(labels, np.uint8(Label.BARE))
    photo, labels = (np.full_like(photo, 190), fog) if shown == "fog" else (photo[::-1].copy(), labels[::-1].copy())
    stated = {"azimuth_deg": 66.0, "pitch_deg": 1.9, "roll_deg": 0.4, "azimuth_sigma_deg": 3.0}
    pose, covariance, verdict = imported_photo(site, tmp_path, photo, labels, **stated)
    assert verdict != "accepted"
    np.testing.assert_allclose(pose.angles_deg, (66.0, 1.9, 0.4), atol=1e-6)
    assert np.degrees(np.sqrt(covariance[5, 5])) == pytest.approx(3.0, rel=0.01)


def test_found_poses_that_agree_say_how_far_off_a_compass_is() -> None:
    error = CompassError.of([-11.0, -12.5, -10.0, -11.5, -80.0])
    assert error.offset_deg == -11.5
    assert error.spread_deg == pytest.approx(1.4826 * 1.0)
    corrected = error.corrected(PosePrior(Pose.from_angles((1.0, 2.0, 3.0), 5.0, 1.0, -2.0), 8.2, 1.0, 1.0, 5.0, 1.5))
    np.testing.assert_allclose(corrected.pose.angles_deg, (353.5, 1.0, -2.0), atol=1e-9)
    assert corrected.azimuth_sigma_deg == pytest.approx(1.2 * 1.4826)
    assert (corrected.pitch_sigma_deg, corrected.position_sigma) == (1.0, 5.0)
