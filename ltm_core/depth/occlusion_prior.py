"""How likely something stands before the ground: by the labels about a place, by how much nearer it is seen, and by how
high it would have to be.

Labels are often wrong about single crowns, and their outlines run some cells beside the photo's. So a pixel is not
judged by its own label but by all those about it: in the middle of a meadow nothing stands, whatever a network of depth
sees there, and in a wood a pixel of grass may well be a crown. And what stands has its foot on the ground: straight
below it in the image the terrain is as near as it is, and from there up to the pixel is its height. Where the terrain
leaps there, at a crest, it stands on the crest, wherever behind that a network sees it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np

from ltm_core.camera import Camera
from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.expected_surface import MOST_ROLL_DEG
from ltm_core.pose import Pose
from ltm_core.types import Float32Array, UInt8Array

NEARER = 0.69
"""Log odds that each e-folding of depth between a thing and the ground behind it adds: what is near hides much."""
MOST_RATIO = 3.0
"""E-foldings from which on they grow no more."""
OPEN = 0.1
"""Chance from which on a depth counts beside the likelier one."""
_EDGE = 1.16  # what log odds lose at an edge as high as the disagreement, and less by its square
_METRE = 0.14  # what they lose with each metre of height
_HIGHEST = 30.0  # metres from which on they lose no more
_NO_FOOT = 1.0  # what they lose where the image ends above the foot
_SEEN, _SEEN_DOUBT = 0.8, 0.4  # of the way from where a network sees a thing to where its foot is: its place, sigma
_ABOUT = 7  # cells, the side of the square whose labels are heard
_MOST_PITCH_DEG = 60.0
_STEP = 4  # rows of the photo between those of `feet`


@dataclass(frozen=True, eq=False)
class OcclusionPrior:
    """What is known of a photo's places before its depth is asked.

    `odds`: (h, w) float32 over the photo, log odds that a place shows something which stands before the ground, when
    that is hardly farther and has no height. `feet`: (w, R) float32 depth of the ground, metres, in the columns of
    `odds` and every fourth row of the photo; 0 where it is not asked. `focal`: pixels of the photo that a plumb metre
    spans at a depth of one.
    """

    odds: Float32Array
    feet: Float32Array
    focal: float

    @classmethod
    def of(
        cls,
        ground: Float32Array,
        labels: UInt8Array | None,
        classes: ClassPriors,
        camera: Camera,
        pose: Pose,
        cells: tuple[int, int],
    ) -> OcclusionPrior:
        """From traced depth of bare ground (H, W) and label ids (H, W), or None. `cells`: (h, w) of the network whose
        depth will be asked about. Of a camera that is rolled by more than 20 degrees, or looks more than 60 down or up,
        no foot is asked: nothing stands along its columns."""
        columns = ((np.arange(cells[1]) + 0.5) * ground.shape[1] / cells[1]).astype(np.intp)
        feet = np.ascontiguousarray(ground[::_STEP, columns].T)
        _, pitch, roll = pose.angles_deg
        if abs(roll) > MOST_ROLL_DEG or abs(pitch) > _MOST_PITCH_DEG:
            feet[:] = 0.0
        focal = camera.fy * math.cos(math.radians(pitch))
        if labels is None:
            return cls(np.full(cells, classes.occluder_log_odds[255], np.float32), feet, focal)
        ids = cv2.resize(labels, cells[::-1], interpolation=cv2.INTER_NEAREST)
        # The sky says nothing of what stands beside it.
        land = (ids != classes.sky).astype(np.float32)
        about = cv2.blur(classes.occluder_log_odds[ids] * land, (_ABOUT, _ABOUT))
        share = np.maximum(cv2.blur(land, (_ABOUT, _ABOUT)), np.float32(1e-3))
        return cls(np.asarray(about / share, np.float32), feet, focal)

    @classmethod
    def none(cls) -> OcclusionPrior:
        """In place of one that is not asked, for kernels."""
        return cls(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32), 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def ground_contact(near: np.float32, column: Float32Array, row: int) -> int:
    """Where in `column` of `OcclusionPrior.feet` the ground below a `row` of the photo is first as near as the inverse
    depth `near`; its length where the image ends above that."""
    # Up a column of the image terrain only gets farther.
    first, last = row // _STEP, len(column)
    while first < last:
        middle = (first + last) // 2
        if column[middle] * near <= np.float32(1.0):
            last = middle
        else:
            first = middle + 1
    return first


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def occlusion_log_odds(
    odds: np.float32,
    near: np.float32,
    true: np.float32,
    edge: np.float32,
    column: Float32Array,
    row: int,
    foot: int,
    focal: np.float32,
) -> np.float32:
    """Log odds that something stands at inverse depth `near` before ground at `true`, which may be 0, in a `row` of the
    photo, where an edge is as high as `edge` of the disagreement. For `odds` and `column` see `OcclusionPrior`, for
    `foot` `ground_contact`."""
    ratio = np.float32(MOST_RATIO)
    if true * np.float32(np.exp(MOST_RATIO)) > near:
        ratio = np.log(near / true)
    odds += np.float32(NEARER) * ratio - np.float32(_EDGE) * edge * edge
    if foot == len(column):
        odds -= np.float32(_NO_FOOT)
    height = np.float32(max(foot * _STEP - row, 0)) / (near * focal)
    return np.float32(odds - np.float32(_METRE) * min(height, np.float32(_HIGHEST)))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def snap_to_contact(near: np.float32, t: np.float32, column: Float32Array, foot: int) -> tuple[np.float32, np.float32]:
    """Inverse depth and its sigma, 1/m, of a thing that a network sees at `near`, with sigma `t`, and whose `foot` is
    known: it stands on the ground that is seen rather than on what a crest hides."""
    if foot == len(column) or not column[foot] > 0:
        return near, t
    nearer = np.float32(1.0) / column[foot] - near
    hidden = np.float32(_SEEN_DOUBT) * nearer
    return near + np.float32(_SEEN) * nearer, np.float32(np.sqrt(t * t + hidden * hidden))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def mixture_moments(
    d: np.float32, s: np.float32, other: np.float32, t: np.float32, likely: np.float32
) -> tuple[np.float32, np.float32]:
    """Mean and sigma, metres, of a depth that is `other`, of sigma `t`, as `likely` as that and else `d`, of `s`."""
    rest = np.float32(1.0) - likely
    apart = other - d
    return d + likely * apart, np.sqrt(likely * t * t + rest * s * s + likely * rest * apart * apart)
