"""PTZ heads on mounts: what holds for every PTZ head, reading and landmark."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scenes.examples import examples
from scipy.spatial.transform import Rotation

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import LensConfig, ZoomLens, ZoomPoint
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.pose_estimation.mount.mount_resection import resect_mount
from ltm_core.pose_estimation.points.control_points import PtzPoints
from ltm_core.visibility.footprint import pixel_rays

angle = st.floats(-180, 180)
lean = st.floats(-3, 3)
tilt = st.floats(-45, 30)
sign = st.sampled_from([1, -1])
PLACE = np.array([10.0, -20.0, 800.0])


@st.composite
def heads(draw: st.DrawFn) -> MountModel:
    base = Pose.from_angles(PLACE, draw(angle) % 360, draw(lean), draw(lean))
    half = np.array(draw(st.lists(st.floats(-0.01, 0.01), min_size=49, max_size=49))).reshape(7, 7)
    return MountModel(base, math.radians(draw(lean)), half @ half.T, draw(sign), draw(sign))


@given(heads(), angle, tilt)
def test_a_pose_is_a_rotation_and_its_covariance_one(head: MountModel, pan: float, up: float) -> None:
    pose, covariance = head.pose(pan, up)
    assert np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max() < 1e-9
    assert np.abs(covariance - covariance.T).max() < 1e-15
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12


@given(heads(), angle, tilt, angle)
def test_pan_turns_about_one_axis_that_no_reading_moves(head: MountModel, pan: float, up: float, by: float) -> None:
    turn = Rotation.from_matrix(head.rotation(pan + by, up) @ head.rotation(pan, up).T).as_rotvec()
    across = turn - (turn @ head.base.rotation[:, 1]) * head.base.rotation[:, 1]
    assert np.linalg.norm(across) < 1e-6


@given(heads(), st.tuples(lean, lean, lean), lean, angle, tilt)
def test_a_correction_turns_every_pose_about_the_map_s_axes(
    head: MountModel, turn: tuple[float, float, float], zero: float, pan: float, up: float
) -> None:
    """As `MountFit` has it: exp(w) R exp(t x)."""
    w, t = np.radians(turn), math.radians(zero)
    corrected = head.corrected(w, t, np.zeros(3), head.covariance)
    expected = (
        Rotation.from_rotvec(w).as_matrix() @ head.rotation(pan, up) @ Rotation.from_rotvec([t, 0, 0]).as_matrix()
    )
    np.testing.assert_allclose(corrected.rotation(pan, up), expected, atol=1e-9)


@st.composite
def lenses(draw: st.DrawFn) -> ZoomLens:
    """Of falling fields of view at growing zooms."""
    count = draw(st.integers(2, 7))
    steps = draw(st.lists(st.floats(0.5, 500), min_size=count, max_size=count))
    falls = draw(st.lists(st.floats(0.3, 0.95), min_size=count, max_size=count))
    zooms, hfovs = np.cumsum(steps), 80 * np.cumprod(falls)
    points = tuple(ZoomPoint(zoom=float(z), hfov_deg=float(f)) for z, f in zip(zooms, hfovs, strict=True))
    return LensConfig(width=1280, height=720, zoom=points).lens()


@given(lenses(), st.floats(0, 1), st.floats(0, 1))
def test_a_longer_zoom_never_shows_more(lens: ZoomLens, a: float, b: float) -> None:
    first, last = lens.table[0][0], lens.table[-1][0]
    low, high = (first + share * (last - first) for share in sorted((a, b)))
    assert lens.camera(high).fx >= lens.camera(low).fx * (1 - 1e-9)
    assert lens.camera(first).hfov_deg <= lens.table[0][1] + 1e-6


@examples(5, in_fuzz=15)
@given(heads(), st.integers(4, 7), st.integers(0, 1_000_000))
def test_the_mount_is_found_whatever_it_is(head: MountModel, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = Camera.from_fov(1280, 720, 55.0)
    lens = LensConfig(width=1280, height=720, zoom=(ZoomPoint(zoom=1, hfov_deg=55.0),)).lens()
    places, pixels, readings = [], [], []
    for k in range(count):
        reading = (float(k * 360 / count + rng.uniform(-15, 15)), float(rng.uniform(-12, 6)))
        pixel = np.array([rng.uniform(100, 1180), rng.uniform(100, 620)])
        places.append(PLACE + head.rotation(*reading) @ pixel_rays(camera, pixel[None])[0] * rng.uniform(500, 5000))
        pixels.append(pixel)
        readings.append((*reading, 1.0))
    names = tuple(f"p{k}" for k in range(count))
    points = PtzPoints(names, np.array(places), np.array(pixels), np.array(readings))
    start = MountModel(Pose.from_angles(PLACE, 0.0), 0.0, np.zeros((7, 7)), head.pan_sign, head.tilt_sign)
    found = resect_mount(points, start, lens, free_focal=False)
    for pan in (0.0, 100.0, 200.0, 300.0):
        turn = Rotation.from_matrix(head.rotation(pan, -3.0).T @ found.model.rotation(pan, -3.0)).magnitude()
        assert math.degrees(turn) < 0.05  # the weak prior of its lean pulls
