"""Compute how likely something stands before the ground.

An object's foot is directly below it in the image, where the terrain is as near as the object, and its height is the
distance from there up to the pixel."""

import math
from typing import NamedTuple

import cv2
import numpy as np

from ltm_core.base.kernels import helper
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.vision.labels import UNLABELLED

_STEP = 4  # rows of the photo between those of `feet`


class OcclusionPrior(NamedTuple):
    """Compiled prior knowledge of objects in front of a photo's ground.

    `odds`: (h, w) float32 over the photo, log odds that a place shows something which stands before the ground, when
    that has no height. `feet`: (w, R) float32 depth of the ground, metres, in the columns of
    `odds` and every fourth row of the photo; 0 where it is not asked. `focal`: pixels of the photo that a plumb metre
    spans at a depth of one. `metre`, `highest`: of `OcclusionConfig`."""

    odds: Float32Array
    feet: Float32Array
    focal: np.float32
    metre: np.float32
    highest: np.float32

    @classmethod
    def of(
        cls,
        ground: Float32Array,
        labels: UInt8Array | None,
        classes: ClassPriors,
        camera: Camera,
        pose: Pose,
        cells: tuple[int, int],
        config: FusionConfig,
    ) -> "OcclusionPrior":
        """Return the prior from traced depth of bare ground (H, W) and label ids (H, W) or None. `cells`: (h, w) of the
        network whose depth will be compared. If the camera is rolled or points steeply up or down, feet are not used,
        because objects do not stand along its columns."""
        columns = ((np.arange(cells[1]) + 0.5) * ground.shape[1] / cells[1]).astype(np.intp)
        feet = np.ascontiguousarray(ground[::_STEP, columns].T)
        _, pitch, roll = pose.angles_deg
        if abs(roll) > config.surface.most_roll_deg or abs(pitch) > config.surface.most_pitch_deg:
            feet[:] = 0.0
        focal = np.float32(camera.fy * math.cos(math.radians(pitch)))
        odds, rules = classes.occluder_log_odds, config.occlusion
        limits = np.float32(rules.metre), np.float32(rules.highest)
        if labels is None:
            return cls(np.full(cells, odds[UNLABELLED], np.float32), feet, focal, *limits)
        ids = cv2.resize(labels, cells[::-1], interpolation=cv2.INTER_NEAREST)
        return cls(np.where(ids == classes.sky, np.float32(0.0), odds[ids]), feet, focal, *limits)

    @classmethod
    def none(cls) -> "OcclusionPrior":
        """Return the unused prior."""
        nothing = np.zeros((1, 1), np.float32)
        return cls(nothing, nothing, np.float32(1.0), np.float32(0.0), np.float32(0.0))


@helper()
def ground_contact(near: np.float32, column: Float32Array, row: int) -> int:
    """Return the first place in `column` of `OcclusionPrior.feet` where the ground below a `row` of the photo is as
    near as the inverse depth `near`; its length if the image ends above that."""
    # Up a column of the image terrain only gets farther.
    first, last = row // _STEP, len(column)
    while first < last:
        middle = (first + last) // 2
        if column[middle] * near <= np.float32(1.0):
            last = middle
        else:
            first = middle + 1
    return first


@helper()
def occlusion_log_odds(
    prior: OcclusionPrior, odds: np.float32, near: np.float32, column: Float32Array, row: int
) -> np.float32:
    """Return the log odds that an object is in front of the ground at inverse depth `near` in a `row` of the photo,
    where labels give the `odds`; `column`: of `OcclusionPrior.feet`."""
    height = height_above(prior, near, row, ground_contact(near, column, row))
    return np.float32(odds - prior.metre * min(height, prior.highest))


@helper()
def height_above(prior: OcclusionPrior, near: np.float32, row: int, foot: int) -> np.float32:
    """Return the height in metres from a `foot` (`ground_contact`) up to a `row` of the photo, at inverse depth
    `near`."""
    return np.float32(max(foot * _STEP - row, 0)) / (near * prior.focal)


@helper()
def mixture_moments(
    d: np.float32, s: np.float32, other: np.float32, t: np.float32, likely: np.float32
) -> tuple[np.float32, np.float32]:
    """Return mean and sigma in metres of a depth that is `other` (sigma `t`) with probability `likely`, else `d` (sigma
    `s`)."""
    rest = np.float32(1.0) - likely
    apart = other - d
    return d + likely * apart, np.sqrt(likely * t * t + rest * s * s + likely * rest * apart * apart)
