import math
from dataclasses import replace

import numpy as np
import pytest

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import LensConfig, ZoomLens, ZoomPoint
from ltm_core.pose_estimation.mount.mount_model import MountModel, Sign
from ltm_core.pose_estimation.mount.mount_resection import resect_mount
from ltm_core.pose_estimation.points.control_points import PtzPoints
from ltm_core.visibility.footprint import pixel_rays

PLACE = np.array([120.0, -340.0, 812.0])
LENS = LensConfig(
    width=1920,
    height=1080,
    zoom=(
        ZoomPoint(zoom=1, hfov_deg=62.6, k1=-0.1),
        ZoomPoint(zoom=257, hfov_deg=34.9),
        ZoomPoint(zoom=1606, hfov_deg=10.5),
    ),
).lens()
BEND = ray_bend(True, 0.13)


def head(azimuth: float = 203.0, pan_sign: Sign = 1, tilt_sign: Sign = 1) -> MountModel:
    """It leans by 0.8 and 0.5 deg, its tilt axis is off by 0.3."""
    base = Pose.from_angles(PLACE, azimuth, 0.8, -0.5)
    return MountModel(base, math.radians(0.3), np.zeros((7, 7)), pan_sign, tilt_sign)


STATED = MountModel(Pose.from_angles(PLACE, 0.0), 0.0, np.zeros((7, 7)))


def marked(
    true: MountModel,
    pans: Float64Array,
    rng: np.random.Generator,
    encoder: float = 0.0,
    noise_px: float = 0.0,
    each: int = 1,
    zooms: tuple[float, ...] = (1.0,),
    lens: ZoomLens = LENS,
) -> PtzPoints:
    """`each` landmarks in a picture at each pan; the encoders are off by `encoder` degrees."""
    names, places, pixels, readings = [], [], [], []
    for k, pan in enumerate(pans):
        tilt, zoom = float(rng.uniform(-8, 4)), zooms[k % len(zooms)]
        rotation = true.rotation(pan + encoder * rng.normal(), tilt + encoder * rng.normal())
        camera = lens.camera(zoom)
        for j in range(each):
            pixel = np.array([rng.uniform(150, 1770), rng.uniform(200, 900)])
            way = rotation @ pixel_rays(camera, pixel[None])[0] * rng.uniform(800, 8000)
            way[2] += BEND * (way[0] ** 2 + way[1] ** 2)
            names.append(f"landmark{k}.{j}")
            places.append(PLACE + way)
            pixels.append(pixel + noise_px * rng.normal(size=2))
            readings.append((pan, tilt, zoom))
    return PtzPoints(tuple(names), np.array(places), np.array(pixels), np.array(readings))


def spread(count: int, rng: np.random.Generator) -> Float64Array:
    return np.asarray((np.arange(count) * 360 / count + rng.uniform(-20, 20, count)) % 360, np.float64)


def worst_error_deg(found: MountModel, true: MountModel) -> float:
    """Over the circle and the tilts that such a camera looks at."""
    errors = []
    for pan in range(0, 360, 15):
        for tilt in (-10.0, 0.0, 5.0):
            cosine = found.rotation(pan, tilt)[:, 2] @ true.rotation(pan, tilt)[:, 2]
            errors.append(math.degrees(math.acos(min(1.0, float(cosine)))))
    return max(errors)


@pytest.mark.parametrize(("pan_sign", "tilt_sign"), [(-1, 1), (1, -1)])
def test_without_noise_the_mount_is_found_exactly_and_so_are_the_signs(pan_sign: Sign, tilt_sign: Sign) -> None:
    true = head(203.0, pan_sign, tilt_sign)
    points = marked(true, np.array([5.0, 80.0, 170.0, 220.0, 300.0]), np.random.default_rng(1))
    found = resect_mount(points, STATED, LENS, BEND, free_focal=False)
    assert (found.model.pan_sign, found.model.tilt_sign) == (pan_sign, tilt_sign)
    assert worst_error_deg(found.model, true) < 2e-3  # the weak prior of a lean pulls by that
    assert np.abs(found.residuals).max() < 0.05
    opposite = [note for note in found.notes if "opposite" in note]
    assert opposite


def test_an_unknown_lens_is_fitted_with_the_mount() -> None:
    """The lens has another focal length and k1 -0.2 at both zooms; the table states none."""
    zooms = (1.0, 257.0)
    lens = LENS.scaled({1.0: 1.02, 257.0: 0.99}, {1.0: -0.1, 257.0: -0.3})
    points = marked(head(), np.arange(0.0, 360.0, 30.0), np.random.default_rng(4), each=4, zooms=zooms, lens=lens)
    found = resect_mount(points, STATED, LENS, BEND, free_k1=True)
    assert worst_error_deg(found.model, head()) < 0.01
    for zoom in zooms:
        assert found.lens.camera(zoom).fx == pytest.approx(lens.camera(zoom).fx, rel=1e-3)
        assert found.lens.camera(zoom).distortion[0] == pytest.approx(lens.camera(zoom).distortion[0], abs=0.02)


@pytest.mark.parametrize(("count", "median", "p95"), [(4, 0.06, 0.21), (8, 0.04, 0.06)])
def test_encoders_of_0_03_deg_leave_what_few_landmarks_must(count: int, median: float, p95: float) -> None:
    """Figures of simulations: four landmarks 0.06 deg (p95 0.21), eight 0.03 (0.055); an azimuth alone 1.24."""
    rng = np.random.default_rng(2)
    true = head()
    worst, sigmas = [], []
    for _ in range(5):
        found = resect_mount(marked(true, spread(count, rng), rng, 0.03, 0.5), STATED, LENS, BEND, free_focal=False)
        worst.append(worst_error_deg(found.model, true))
        sigmas.append(found.worst[1])
    assert np.median(worst) <= median
    assert np.quantile(worst, 0.95) <= p95
    # What it says of itself is neither too small nor too large.
    assert 0.5 < np.median(np.array(worst) / np.array(sigmas)) < 2.0
    azimuth_only = MountModel(Pose.from_angles(PLACE, true.base.angles_deg[0]), 0.0, np.zeros((7, 7)))
    assert worst_error_deg(azimuth_only, true) > 1.0


def test_a_landmark_marked_wrongly_is_left_out_and_named() -> None:
    rng = np.random.default_rng(4)
    points = marked(head(), spread(9, rng), rng, 0.03, 0.5)
    pixels = points.pixels.copy()
    pixels[3] += (90.0, -40.0)
    found = resect_mount(replace(points, pixels=pixels), STATED, LENS, BEND, free_focal=False)
    assert [name for name, used in zip(points.names, found.used, strict=True) if not used] == ["landmark3.0"]
    assert worst_error_deg(found.model, head()) < 0.1


def test_the_place_is_found_where_it_is_free() -> None:
    rng = np.random.default_rng(5)
    points = marked(head(), spread(8, rng), rng, 0.002, 0.1, each=3)
    shifted = PLACE + np.array([6.0, -4.0, 3.0])
    covariance = np.zeros((7, 7))
    covariance[:3, :3] = 25.0 * np.eye(3)
    start = replace(STATED, base=Pose.from_angles(shifted, 0.0), covariance=covariance)
    found = resect_mount(points, start, LENS, BEND, free_focal=False, free_position=True)
    assert np.abs(found.model.base.position - PLACE).max() < 0.7
    held = resect_mount(points, start, LENS, BEND, free_focal=False)
    assert held.model.base.position.tolist() == shifted.tolist()
    assert np.abs(held.residuals).sum() > 2 * np.abs(found.residuals).sum()


def test_fewer_than_four_landmarks_are_refused() -> None:
    rng = np.random.default_rng(6)
    with pytest.raises(PoseError, match="3 landmarks"):
        resect_mount(marked(head(), spread(3, rng), rng), STATED, LENS, BEND)


def test_landmarks_crowded_in_pan_are_told_with_where_to_mark_others() -> None:
    rng = np.random.default_rng(8)
    found = resect_mount(marked(head(), np.array([20.0, 24.0, 29.0, 33.0]), rng, 0.03, 0.5), STATED, LENS, BEND)
    (note,) = found.notes
    assert "span 13 deg of pan only" in note
    assert 140 < found.worst[0] < 270
    assert found.worst[1] > 0.3
