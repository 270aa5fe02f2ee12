"""Depth images as observations of a surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.errors import ImageError, PoseError
from ltm_core.pose import Pose
from ltm_core.terrain.observe_kernel import Ground, Limits, Pixels, Seen, View, observe
from ltm_core.terrain.reference import BLOCK, Reference
from ltm_core.tracing import TerrainTracer

Image = NDArray[np.float32]
Covariance = NDArray[np.float64]

_WIDEST_WINDOW = 24
"""Pixels: a pose so uncertain that a silhouette may lie farther off says nothing of silhouettes anyway."""


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """One posed depth image.

    `depth`, `sigma`: (H, W) float32 metres along the optical axis; depth +inf sky, NaN unknown. `measured`: (H, W)
    bool, where depth is a measurement; False where it was copied from the terrain, which then says nothing of it.
    `labels`: (H, W) uint8 class ids or None. `covariance`: (6, 6) of the pose over x, y, z (m) and rotations about the
    map's axes (rad); None: not known. `stable`: (H, W) bool, open ground that does not grow, where the frame itself
    tells it, or None. Raises ImageError where shapes differ, PoseError for a covariance that is none.
    """

    depth: Image
    sigma: Image
    measured: NDArray[np.bool_]
    camera: Camera
    pose: Pose
    stamp_ns: int
    source: str
    covariance: Covariance | None = None
    labels: NDArray[np.uint8] | None = None
    stable: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        for name in ("depth", "sigma", "measured", "labels", "stable"):
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise ImageError(f"{name} image of {array.shape} does not fit a camera of {shape} (rows, columns)")
        if self.covariance is not None:
            matrix = np.asarray(self.covariance, np.float64)
            if matrix.shape != (6, 6) or not np.isfinite(matrix).all() or (np.diag(matrix) < 0).any():
                raise PoseError(
                    f"the pose of {self.source} has a covariance that is none: it must be a finite 6 x 6 matrix "
                    f"without negative variances, got {matrix.tolist()}"
                )


def assumed_covariance(angle_sigma_deg: float, position_sigma: float) -> Covariance:
    """Of a pose that comes without one."""
    return np.diag([position_sigma**2] * 3 + [math.radians(angle_sigma_deg) ** 2] * 3)


class Observer:
    """Turns depth images into observations of a reference surface. Keeps its arrays from frame to frame."""

    def __init__(self, reference: Reference, tracer: TerrainTracer, limits: Limits, step: int) -> None:
        geometry = reference.geometry
        self._ground = Ground(
            reference.surface,
            reference.slopes.east,
            reference.slopes.north,
            BLOCK,
            geometry.x_min,
            geometry.y_max,
            geometry.resolution,
        )
        self._tracer, self._limits, self._step = tracer, limits, step
        self._seen: Seen | None = None
        self.pixels: Pixels
        """Those of the last frame."""

    def predict(self, frame: DepthFrame) -> Image:
        """The slant ranges that the reference has for the pixels in use. Raises PoseError as the tracer does."""
        return self._tracer.trace(frame.camera.scaled(self._step), frame.pose).range

    def observe(self, frame: DepthFrame, expected: Image, covariance: Covariance) -> tuple[Seen, int]:
        """The observations, valid until the next call, and how many cells were carved."""
        step = self._step
        camera = frame.camera.scaled(step)
        rays = camera.rays()
        along = (1 / rays[..., 2]).astype(np.float32)
        slant, sigma = frame.depth[::step, ::step] * along, frame.sigma[::step, ::step] * along
        measured = np.ascontiguousarray(frame.measured[::step, ::step]).view(np.uint8)
        turn = math.sqrt(float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))
        window = min(1 + math.ceil(self._limits.gate * turn * camera.fx), _WIDEST_WINDOW)
        known = np.where(np.isnan(expected), np.float32(np.inf), expected)
        near, far = _extremes(known, 1)
        nearest, farthest = (near, far) if window == 1 else _extremes(known, window)
        self.pixels = pixels = Pixels(slant, sigma, measured, np.asarray(expected), nearest, farthest, near, far)
        view = View(
            rays,
            np.ascontiguousarray(frame.pose.rotation),
            np.ascontiguousarray(frame.pose.position),
            np.ascontiguousarray(covariance),
            self._tracer.bend,
        )
        seen = self._arrays(slant.size)
        return seen, int(observe(self._ground, view, pixels, self._limits, seen))

    def labels(self, frame: DepthFrame) -> NDArray[np.uint8]:
        """Of the pixels in use, flat; empty where the frame has none."""
        if frame.labels is None:
            return np.empty(0, np.uint8)
        return np.ascontiguousarray(frame.labels[:: self._step, :: self._step]).ravel()

    def _arrays(self, count: int) -> Seen:
        if self._seen is None or len(self._seen.kind) != count:
            dz, variance, sheet, pose = (np.empty(count, np.float32) for _ in range(4))
            carved = np.empty(2 * count, np.int32), np.empty(2 * count, np.float32)
            self._seen = Seen(np.empty(count, np.uint8), np.empty(count, np.int32), dz, variance, sheet, pose, *carved)
        return self._seen


def _extremes(ranges: Image, radius: int) -> tuple[Image, Image]:
    """Least and greatest range within `radius` pixels."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.asarray(cv2.erode(ranges, kernel), np.float32), np.asarray(cv2.dilate(ranges, kernel), np.float32)
