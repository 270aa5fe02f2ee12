"""Uncertainty and footprints: closed forms over a level plane, and Monte Carlo over rough ground."""

from __future__ import annotations

import numpy as np
import pytest
from scenes.rasters import rough_terrain, standing, tilted_plane
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import PoseError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.footprint import TracedUncertainty, ground_normals, traced_uncertainty

pytestmark = pytest.mark.kernel

LEVEL = tilted_plane(0.0, 0.0, 400.0).dem
HEIGHT = 40.0
CAMERA = Camera(41, 31, 60.0, 60.0, 20.0, 15.0)
# Looks east, so that pitch turns about the map's y axis and azimuth about z.
POSE = Pose.from_angles((-150.0, 10.0, 400.0 + HEIGHT), 90.0, -25.0)
CENTRE = (15, 20)
DEPRESSION = np.radians(25.0)
RANGE = HEIGHT / np.sin(DEPRESSION)


def on_plane(**variances: float) -> TracedUncertainty:
    """With independent x, y, z, rx, ry, rz standard deviations."""
    sigmas = [variances.get(name, 0.0) for name in ("x", "y", "z", "rx", "ry", "rz")]
    traced = TerrainTracer(LEVEL, curvature=False).trace(CAMERA, POSE)
    return traced_uncertainty(traced, LEVEL, np.diag(np.square(sigmas)))


def centre(result: TracedUncertainty) -> tuple[float, float, float]:
    return float(result.along[CENTRE]), float(result.across[CENTRE]), float(result.over[CENTRE])


def test_a_higher_camera_sees_further_along_the_ground() -> None:
    along, across, over = centre(on_plane(z=0.5))
    # The point slides by dz / tan(depression) along the ground; the ray frame splits that.
    slide = 0.5 / np.tan(DEPRESSION)
    assert along == pytest.approx(slide * np.cos(DEPRESSION), rel=1e-4)
    assert over == pytest.approx(slide * np.sin(DEPRESSION), rel=1e-4)
    assert across == pytest.approx(0.0, abs=1e-6)


def test_a_moved_camera_moves_its_points() -> None:
    along, across, over = centre(on_plane(x=0.7))
    assert np.hypot(along, over) == pytest.approx(0.7, rel=1e-4)
    assert centre(on_plane(y=0.3))[1] == pytest.approx(0.3, rel=1e-4)
    assert across == pytest.approx(0.0, abs=1e-6)


def test_pitch_moves_by_range_squared_over_height() -> None:
    result = on_plane(ry=1e-3)
    along, across, over = centre(result)
    assert over == pytest.approx(1e-3 * RANGE, rel=1e-4)
    assert np.hypot(along, over) == pytest.approx(1e-3 * RANGE**2 / HEIGHT, rel=1e-4)
    assert across == pytest.approx(0.0, abs=1e-6)
    assert result.total[CENTRE] == pytest.approx(np.hypot(along, over), rel=1e-6)


def test_azimuth_moves_by_horizontal_range() -> None:
    along, across, over = centre(on_plane(rz=2e-3))
    assert across == pytest.approx(2e-3 * RANGE * np.cos(DEPRESSION), rel=1e-4)
    assert np.hypot(along, over) == pytest.approx(0.0, abs=1e-5)


def test_variances_add_and_correlations_count() -> None:
    z, pitch = 0.5, 1e-3
    apart = np.hypot(on_plane(z=z).along, on_plane(ry=pitch).along)
    assert on_plane(z=z, ry=pitch).along[CENTRE] == pytest.approx(apart[CENTRE], rel=1e-5)
    # A camera that is too high and looks down too far by just as much sees the same point; one too low is off twice.
    traced = TerrainTracer(LEVEL, curvature=False).trace(CAMERA, POSE)
    turn = z * np.cos(DEPRESSION) / RANGE
    for sign, factor in ((1.0, 0.0), (-1.0, 2.0)):
        together = np.array([0.0, 0.0, z, 0.0, sign * turn, 0.0])
        result = traced_uncertainty(traced, LEVEL, np.outer(together, together))
        assert result.total[CENTRE] == pytest.approx(factor * z / np.tan(DEPRESSION), rel=1e-4, abs=1e-5)


def test_dem_error_moves_points_along_their_rays() -> None:
    traced = TerrainTracer(LEVEL, curvature=False).trace(CAMERA, POSE)
    result = traced_uncertainty(traced, LEVEL, np.zeros((6, 6)), dem_sigma=0.2)
    assert result.along[CENTRE] == pytest.approx(0.2 / np.sin(DEPRESSION), rel=1e-4)
    assert result.across[CENTRE] == 0


def test_footprints_on_a_level_plane() -> None:
    result = on_plane()
    assert result.footprint_across[CENTRE] == pytest.approx(RANGE / 60, rel=1e-4)
    assert result.footprint_along[CENTRE] == pytest.approx(RANGE / 60 / np.sin(DEPRESSION), rel=1e-4)


def test_footprints_straight_down() -> None:
    down = Pose.from_angles((3.0, 5.0, 400.0 + HEIGHT), 0.0, -90.0)
    traced = TerrainTracer(LEVEL).trace(CAMERA, down)
    result = traced_uncertainty(traced, LEVEL, np.diag([0.1, 0.1, 0.0, 0.0, 0.0, 0.0]) ** 2)
    assert result.footprint_along[CENTRE] == pytest.approx(HEIGHT / 60, rel=1e-3)
    assert result.footprint_across[CENTRE] == pytest.approx(HEIGHT / 60, rel=1e-3)
    assert result.across[CENTRE] == pytest.approx(0.1, rel=1e-3)
    assert not result.grazing.any()


def test_footprints_tile_the_ground() -> None:
    # Neighbouring pixels of a distorted, rolled camera: their traced points are a footprint apart.
    camera = Camera(41, 31, 60.0, 66.0, 18.0, 13.0, (-0.2, 0.05, 0.003, -0.002, 0.0))
    scene = tilted_plane(0.11, -0.07, 400.0)
    # The middle pixel of a level row looks along the heading: no roll, so u is across and v is along there.
    pose = Pose.from_angles(
        (-150.0, 10.0, float(scene.surface(np.array(-150.0), np.array(10.0))) + 40), 70.0, -25.0, 9.0
    )
    traced = TerrainTracer(scene.dem, curvature=False).trace(camera, pose)
    result = traced_uncertainty(traced, scene.dem, np.zeros((6, 6)))
    points = traced.points().astype(np.float64)
    u_step = (points[14, 12] - points[14, 10]) / 2
    v_step = (points[15, 11] - points[13, 11]) / 2
    normal = ground_normals(scene.dem, points[14, 11, :1], points[14, 11, 1:2])[0]
    ray = points[14, 11] - pose.position
    right = np.cross(ray, (0.0, 0.0, 1.0))
    right -= normal * (right @ normal)
    right /= np.linalg.norm(right)
    away = np.cross(normal, right)
    assert result.footprint_along[14, 11] == pytest.approx(abs(u_step @ away) + abs(v_step @ away), rel=0.01)
    assert result.footprint_across[14, 11] == pytest.approx(abs(u_step @ right) + abs(v_step @ right), rel=0.01)


def test_grazing_pixels_say_so() -> None:
    low = Pose.from_angles((-150.0, 10.0, 402.0), 90.0, -1.0)
    traced = TerrainTracer(LEVEL, curvature=False).trace(CAMERA, low)
    result = traced_uncertainty(traced, LEVEL, np.zeros((6, 6)), grazing_deg=3.0)
    angle = np.degrees(np.arcsin(2.0 / traced.range[:, 20]))
    seen = np.isfinite(traced.range[:, 20])
    assert np.array_equal(result.grazing[seen, 20], angle[seen] < 3.0)
    assert 0 < result.grazing[seen, 20].sum() < seen.sum()
    assert not result.grazing[~np.isfinite(traced.range)].any()


def test_sky_has_no_uncertainty() -> None:
    up = Pose.from_angles((-150.0, 10.0, 440.0), 90.0, 5.0)
    traced = TerrainTracer(LEVEL, curvature=False).trace(CAMERA, up)
    assert np.isposinf(traced.range).any()
    result = traced_uncertainty(traced, LEVEL, np.eye(6))
    for layer in (result.along, result.across, result.over, result.footprint_along, result.footprint_across):
        assert np.isnan(layer[~np.isfinite(traced.range)]).all()


def test_monte_carlo_over_rough_ground() -> None:
    dem = rough_terrain(7, (161, 243), resolution=2.0)
    tracer = TerrainTracer(dem)
    camera = Camera(24, 18, 30.0, 30.0, 11.0, 8.5, (-0.1, 0.0, 0.0, 0.0, 0.0))
    pose = Pose.from_angles(standing(dem, 120.0, 60.0, 35.0), 60.0, -25.0, 4.0)
    rng = np.random.default_rng(2)
    shape = rng.normal(size=(6, 6)) * np.array([0.02, 0.02, 0.02, 1e-4, 1e-4, 1e-4])[:, None]
    covariance = shape @ shape.T
    traced = tracer.trace(camera, pose)
    result = traced_uncertainty(traced, dem, covariance)
    offsets = []
    for draw in rng.multivariate_normal(np.zeros(6), covariance, size=300):
        turned = Rotation.from_rotvec(draw[3:]).as_matrix() @ pose.rotation
        offsets.append(tracer.trace(camera, Pose(pose.position + draw[:3], turned)).points() - traced.points())
    errors = np.array(offsets, np.float64)
    away = traced.points() - pose.position
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    right = np.cross(away, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    steady = np.isfinite(result.along) & ~result.grazing
    for predicted, axis in ((result.along, away), (result.across, right), (result.over, np.cross(right, away))):
        measured = np.sqrt(np.mean(np.sum(errors * axis, axis=-1) ** 2, axis=0))
        ratio = (measured / predicted)[steady]
        # 300 draws know a sigma to 4 %; on rough ground the slope over one cell is not that at the point.
        assert np.median(ratio) == pytest.approx(1.0, abs=0.06)
        assert np.mean(np.abs(np.log(ratio)) < 0.35) > 0.8


def test_bad_arguments() -> None:
    traced = RangeImage(np.full((31, 41), 10, np.float32), CAMERA, POSE)
    with pytest.raises(PoseError, match="6 x 6"):
        traced_uncertainty(traced, LEVEL, np.eye(3))
    lopsided = np.eye(6)
    lopsided[0, 3] = 0.5
    with pytest.raises(PoseError, match="symmetric"):
        traced_uncertainty(traced, LEVEL, lopsided)
    with pytest.raises(PoseError, match="0 or more"):
        traced_uncertainty(traced, LEVEL, np.eye(6), dem_sigma=-1.0)
