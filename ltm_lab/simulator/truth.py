"""True ranges and classes of a frame's pixels, and the site's true fuel raster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SKY, TREE, UNLABELLED, LandCover
from ltm_lab.simulator.mitsuba_scene import EyePointScenes
from ltm_lab.simulator.render import render_range


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


def fuel_truth(cover: LandCover, geometry: GridGeometry, offset: tuple[float, float]) -> UInt8Array:
    """Majority class of each cell of `geometry` (CRS coordinates; `offset` is the CRS position of map (0, 0)); ties
    go to the lower id."""
    fine = cover.geometry
    rows, cols = np.mgrid[0 : fine.height, 0 : fine.width]
    x, y = fine.to_map(rows, cols)
    row, col = geometry.cell_of(x + offset[0], y + offset[1])
    inside = geometry.contains(row, col)
    counts = np.zeros((geometry.height * geometry.width, 8), np.int64)
    np.add.at(counts, ((row * geometry.width + col)[inside], np.minimum(cover.classes[inside], 7)), 1)
    out = counts.argmax(axis=1).astype(np.uint8)
    out[counts.sum(axis=1) == 0] = 255
    return np.asarray(out.reshape(geometry.shape), np.uint8)
