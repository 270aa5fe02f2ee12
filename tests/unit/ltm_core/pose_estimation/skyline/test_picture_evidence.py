import numpy as np
import pytest
from scenes.mountain_view import BEND, CAMERA, TRUE, view

from ltm_core.geometry.grid import GridGeometry
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.image_edges import image_skyline
from ltm_core.pose_estimation.skyline.terrain_horizon import terrain_horizon
from ltm_core.raster.dem import Dem
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround
from ltm_core.vision.labels import Label


def test_a_caption_and_a_corner_do_not_cover_the_sky_and_a_mast_is_no_skyline() -> None:
    photo, labels = view(TRUE)
    plain = picture_evidence(photo, labels, CAMERA).skyline
    assert plain is not None
    rows, cols = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    caption = rows < CAMERA.height // 20
    corner = rows + cols < CAMERA.height // 4
    mast = (np.abs(cols - 3 * CAMERA.width // 4) < CAMERA.width // 20) & (rows > CAMERA.height // 10)
    hidden = caption | corner | mast
    spoilt = np.where(hidden, np.uint8(Label.TREE), labels)
    found = picture_evidence(photo, spoilt, CAMERA, hidden=hidden).skyline
    assert found is not None
    behind_mast = np.abs(plain.u - 3 * CAMERA.width // 4) < CAMERA.width // 20 - 1
    beside = ~np.isin(plain.u, plain.u[np.abs(plain.u - 3 * CAMERA.width // 4) < CAMERA.width // 20 + 1])
    assert not np.isin(found.u, plain.u[behind_mast]).any()
    assert np.isin(plain.u[beside], found.u).mean() > 0.98
    both = np.isin(found.u, plain.u)
    np.testing.assert_allclose(found.v[both], plain.v[np.isin(plain.u, found.u)], atol=0.6)


def test_the_photo_s_skyline_is_found_to_a_part_of_a_pixel() -> None:
    rows, cols = np.mgrid[0:200, 0:320]
    true = 90.0 + 0.11 * cols[0] + 6 * np.sin(cols[0] / 23.0)
    ground = np.clip(rows - true + 0.5, 0, 1)[..., None]
    photo = (ground * [60.0, 70.0, 40.0] + (1 - ground) * [180.0, 200.0, 230.0]).astype(np.uint8)
    rough = np.where(rows < true + 2.4, np.uint8(Label.SKY), np.uint8(Label.SHRUB)).astype(np.uint8)
    found = image_skyline(photo, rough)
    away = found.v - true[found.u.astype(int)]
    assert len(found.u) > 200
    assert np.median(np.abs(away)) < 0.15
    assert np.percentile(np.abs(away), 90) < 0.4
    assert (found.cover == Label.SHRUB).all()


def walls(near: float = 30.0, far: float = 90.0) -> Dem:
    """Flat ground at 100 m with two walls from west to east, 400 m and 1000 m north of y = 200."""
    geometry = GridGeometry(0.0, 1500.0, 5.0, 240, 300)
    rows, cols = np.mgrid[0:300, 0:240]
    _, y = geometry.to_map(rows, cols)
    z = np.full(y.shape, 100.0)
    z[np.abs(y - 600.0) < 6] += near
    z[np.abs(y - 1200.0) < 6] += far
    return Dem(z.astype(np.float32), geometry)


def test_the_horizon_of_two_walls() -> None:
    horizon = terrain_horizon(walls(), np.array([600.0, 200.0, 110.0]), BEND, NOTHING_BEYOND, half_width=0.2)
    straight = int(np.argmin(np.abs(horizon.azimuths)))
    assert horizon.range[straight] == pytest.approx(995.0, abs=6.0)
    r = horizon.range[straight]
    assert horizon.tangent[straight] == pytest.approx(80.0 / r - BEND * r, abs=1e-4)
    # The lower wall before it is an occluding contour, and what comes into view behind it is the higher one.
    contours = horizon.contours
    k = int(np.argmin(np.abs(contours.azimuth)))
    assert contours.range[k] == pytest.approx(395.0, abs=6.0)
    assert contours.tangent[k] == pytest.approx(20.0 / contours.range[k], abs=1e-3)
    assert contours.following[k] == k + 1
    assert not horizon.open.any()


def test_land_beyond_the_dem_leaves_the_horizon_open() -> None:
    place = np.array([600.0, 200.0, 110.0])
    low = terrain_horizon(walls(), place, BEND, PossibleGround(highest=150.0), half_width=0.2)
    high = terrain_horizon(walls(), place, BEND, PossibleGround(highest=900.0), half_width=0.2)
    assert not low.open.any(), "no higher than the wall of 190 m"
    assert high.open.all()
    assert (high.bound > high.tangent + 0.1).all()
