"""Renders with Mitsuba through our cameras: radiance images, true ranges through pixel centres, true classes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ltm_core.base.errors import CameraError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SKY, TREE, UNLABELLED, LandCover
from ltm_lab.simulator.mitsuba_scene import EyePointScenes, mitsuba

_NEAR = 0.1  # m


def _sensor(
    camera: Camera, pose: Pose, sampler: dict[str, Any], pixel_format: str, shift: tuple[float, float] = (0.0, 0.0)
) -> Any:
    """Pinhole sensor; `shift` (du, dv) moves where in the pixel a centre sample falls. Raises CameraError on
    distortion."""
    mi = mitsuba()
    if any(camera.distortion):
        raise CameraError(
            f"the renderer takes undistorted cameras, got distortion {camera.distortion}: "
            "render a wider image and warp it"
        )
    if abs(camera.fx - camera.fy) > 1e-6 * camera.fx:
        raise CameraError(f"the renderer takes square pixels, got fx={camera.fx}, fy={camera.fy}")
    right, down, forward = pose.rotation.T
    # Mitsuba's camera looks along +z with +x to the left and +y up
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = -right, -down, forward, pose.position
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "fov_axis": "x",
            # Our centre (u) sits at u + 0.5 of Mitsuba's image plane, which spans [0, width]
            "principal_point_offset_x": 0.5 - (camera.cx + 0.5 - shift[0]) / camera.width,
            "principal_point_offset_y": 0.5 - (camera.cy + 0.5 - shift[1]) / camera.height,
            "near_clip": _NEAR,
            "far_clip": 1e6,
            "to_world": mi.ScalarTransform4f(matrix),
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "rfilter": {"type": "box"},
                "pixel_format": pixel_format,
                "component_format": "float32",
            },
            "sampler": sampler,
        }
    )


@dataclass(frozen=True)
class Radiance:
    """Linear RGB (H, W, 3) without haze, as the sun alone and as the sky alone (light from other ground included) give
    it."""

    sun: Float32Array
    sky: Float32Array


def render_radiance(view: EyePointScenes, camera: Camera, pose: Pose, samples: int, seed: int) -> Radiance:
    """Return what reaches the lens through clear air; the same seed gives the same image.

    Sun and sky are rendered apart: the sky's light, which is soft but noisy, can be smoothed, edges of shadows cannot.
    """
    mi = mitsuba()
    integrator = mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0})
    light = mi.traverse(view.light)
    parts = []
    try:
        for k, (sun, sky) in enumerate(((1.0, 0.0), (0.0, 1.0))):
            light["sun_scale"], light["sky_scale"] = sun, sky
            light.update()
            # Jittered in the pixel, both kinds need fewer paths than `samples` drawn one by one
            paths = max(1, round((0.5 if sky else 0.6) * samples))
            sensor = _sensor(camera, pose, {"type": "multijitter", "sample_count": paths}, "rgb")
            paths = sensor.sampler().sample_count()  # which takes whole grids
            image = mi.render(view.full, sensor=sensor, integrator=integrator, spp=paths, seed=2 * seed + k)
            parts.append(np.asarray(image, np.float32))
    finally:
        light["sun_scale"], light["sky_scale"] = 1.0, 1.0
        light.update()
    return Radiance(parts[0], parts[1])


def render_range(scene: Any, camera: Camera, pose: Pose, shift: tuple[float, float] = (0.0, 0.0)) -> Float32Array:
    """Range along the ray (H, W) through each pixel's centre plus `shift` pixels; +inf where nothing is hit."""
    mi = mitsuba()
    sensor = _sensor(camera, pose, {"type": "stratified", "sample_count": 1, "jitter": False}, "luminance", shift)
    t = np.asarray(mi.render(scene, sensor=sensor, integrator=mi.load_dict({"type": "depth"}), spp=1), np.float64)
    t = t.reshape(camera.height, camera.width)
    # Mitsuba starts its rays on the near plane
    u = (np.arange(camera.width) + shift[0] - camera.cx) / camera.fx
    v = (np.arange(camera.height) + shift[1] - camera.cy) / camera.fy
    start = _NEAR * np.sqrt(1 + u[None, :] ** 2 + v[:, None] ** 2)
    return np.where(t > 0, t + start, np.inf).astype(np.float32)


def air_length(ranges: Float32Array, camera: Camera, pose: Pose) -> Float32Array:
    """Metres of the site's haze in front of each pixel (H, W), out of its range.

    Sky rays leave the haze through its top, 100 m over the eye; those level or lower see nothing but haze (the
    sky model
    is black under the horizon).
    """
    up = np.asarray(camera.rays() @ pose.rotation[2], np.float32)
    return np.where(np.isinf(ranges), 100.0 / np.maximum(up, 1e-4), ranges).astype(np.float32)


def airlight(view: EyePointScenes, camera: Camera, pose: Pose, pitch_deg: float = 1.0) -> Float32Array:
    """Radiance (3,) of the sky in the camera's heading, just over the horizon unless told: what haze fades to."""
    azimuth, _, _ = pose.angles_deg
    strip = Camera.from_fov(96, 2, min(camera.hfov_deg, 90.0))
    level = Pose.from_angles((0.0, 0.0, 0.0), azimuth, pitch_deg)
    mi = mitsuba()
    sensor = _sensor(strip, level, {"type": "independent", "sample_count": 8}, "rgb")
    sky = np.asarray(
        mi.render(view.sky, sensor=sensor, integrator=mi.load_dict({"type": "path", "max_depth": 2}), spp=8, seed=0)
    )
    # The median leaves the sun's disc out
    return np.asarray(np.median(sky.reshape(-1, 3), axis=0), np.float32)


@dataclass(frozen=True)
class FrameTruth:
    """Of each pixel of `camera`: `range_surface` to what is seen, `range_ground` to the bare ground behind it (both
    (H, W) float32, slant metres, +inf sky), `labels` (H, W) uint8."""

    range_surface: Float32Array
    range_ground: Float32Array
    labels: UInt8Array
    camera: Camera


def frame_truth(view: EyePointScenes, camera: Camera, pose: Pose, cover: LandCover) -> FrameTruth:
    """Cast a ray through every pixel centre of `camera`, at the ground alone and at each kind of plant alone.

    The class is the kind that is hit first; the ground itself takes the class map's (under trees grass, about houses
    bare), and ranges beyond the map stay unlabelled.
    """
    ground = render_range(view.ground, camera, pose)
    labels = _ground_labels(ground, camera, pose, view.bend, cover)
    surface = ground.copy()
    for class_id, scene in view.kinds:
        ranges = render_range(scene, camera, pose)
        labels[ranges < surface] = class_id
        surface = np.minimum(surface, ranges)
    return FrameTruth(surface, ground, labels, camera)


def _ground_labels(ranges: Float32Array, camera: Camera, pose: Pose, bend: float, cover: LandCover) -> UInt8Array:
    rays = camera.rays() @ pose.rotation.T
    hit = np.isfinite(ranges)
    points = pose.position + rays * np.where(hit, ranges, 0.0)[..., None]
    labels = cover.at(points[..., 0], points[..., 1]).copy()
    labels[~cover.geometry.contains(*cover.geometry.cell_of(points[..., 0], points[..., 1]))] = UNLABELLED
    labels[labels == TREE] = GRASS  # what shows between crowns is their understorey
    labels[labels == BUILT] = BARE  # and between walls, the yard
    labels[~hit] = SKY
    return labels
