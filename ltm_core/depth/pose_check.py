"""Check that the terrain matches the photo: traced silhouettes against the photo's edges.

The traced silhouettes are shifted over the photo's vertical gradient. The pose is suspected if only turns beyond the
tolerance meet about as much contrast as the best one. Crests so near that cover moves their edges are left out."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Int32Array, UInt8Array
from ltm_core.depth.fusion_config import PoseCheckConfig, SurfaceConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.geometry.camera import Camera
from ltm_core.vision.labels import UNLABELLED


@dataclass(frozen=True)
class PoseCheck:
    """Result of the check. `edges`: number of terrain edges used. `pitch_deg`, `azimuth_deg`: turn of the camera (up,
    clockwise) with the best fit, 0 if unknown. `gain`: ratio of the fits. `suspected`, and `reason` in words."""

    edges: int = 0
    pitch_deg: float = 0.0
    azimuth_deg: float = 0.0
    gain: float = 1.0
    suspected: bool = False
    reason: str = ""
    checked: bool = False
    """Whether there was enough evidence to detect a wrong pose."""


def check_pose(
    rgb: UInt8Array,
    ground: Float32Array,
    camera: Camera,
    angle_sigma: float,
    dem_sigma: float,
    config: PoseCheckConfig,
    labels: UInt8Array | None = None,
    classes: ClassPriors | None = None,
    jump: float = SurfaceConfig().jump,
    hidden: BoolArray | None = None,
) -> PoseCheck:
    """Check one photo (H, W, 3) and its labels (H, W), if any, against its traced depth (H, W). `angle_sigma`,
    `dem_sigma`: tolerances in radians and metres. `jump`: ratio of depths between two surfaces. `hidden`: (H, W),
    pixels that do not show the terrain."""
    nearest = (config.cover + dem_sigma) / math.radians(config.near_deg)
    rows, cols = _far_edges(ground, jump, nearest, config.most_edges, hidden)
    if labels is not None and classes is not None:
        # Without trees' edges, by the labels right above and below, unless so far that trees are not much.
        crest, beside = classes.crest, labels[np.maximum(rows - config.beside, 0), cols]
        height = np.maximum(crest[beside], crest[labels[rows, cols]])
        far = ground[rows, cols] > (height + dem_sigma) / math.radians(config.near_deg)
        clear = far | (height <= crest[UNLABELLED])
        rows, cols = rows[clear], cols[clear]
    if len(rows) < config.least_edges:
        return PoseCheck(len(rows))
    allowed = config.allowed_deg + 3 * math.degrees(angle_sigma)
    pitch, azimuth, gain, suspected = _check_edges(rgb, rows, cols, camera, allowed, config)
    reason = f"the photo's edges fit the terrain's silhouettes {gain:.1f} times better with the camera turned by "
    reason += f"{pitch:+.2f} deg of pitch and {azimuth:+.2f} deg of azimuth"
    return PoseCheck(len(rows), pitch, azimuth, gain, suspected, reason if suspected else "", True)


def _check_edges(
    rgb: UInt8Array, rows: Int32Array, cols: Int32Array, camera: Camera, allowed_deg: float, config: PoseCheckConfig
) -> tuple[float, float, float, bool]:
    """Return the pitch and azimuth of the best turn, degrees, its gain, and whether the pose is suspected."""
    shrink = max(1, round(rgb.shape[1] / config.cells))  # photo pixels a cell
    reach = int(math.radians(config.reach_deg) * camera.fy / shrink)
    scores = _scores(_contrast(rgb, shrink), rows // shrink, cols // shrink, reach)
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    usual = float(np.median(scores))
    spread = 1.4826 * float(np.median(np.abs(scores - usual)))
    place = np.unravel_index(int(np.argmax(scores)), scores.shape)
    best = float(scores[place])
    here = float(scores[np.hypot(v, u) <= 1.0].max())
    turns = np.degrees(np.hypot(v, u) * shrink / camera.fy)
    least = float(turns[scores >= usual + config.as_well * (best - usual)].min())
    clear = best >= max(config.contrast, usual + config.outstanding * spread) and here < config.clearly * best
    pitch = math.degrees((int(place[0]) - reach) * shrink / camera.fy)
    azimuth = -math.degrees((int(place[1]) - reach) * shrink / camera.fx)
    return pitch, azimuth, best / max(here, 1e-3), bool(clear and least > allowed_deg)


def _far_edges(
    ground: Float32Array, jump: float, nearest: float, most: int, hidden: BoolArray | None
) -> tuple[Int32Array, Int32Array]:
    """Return the pixels (rows, cols), from the topmost down, above which is sky or ground farther by twice a jump, in
    every other row and column, of ground beyond `nearest` metres; where known ground merely ends there is no edge to be
    seen."""
    here, above = ground[1::2, ::2], ground[: len(ground) // 2 * 2 : 2, ::2]
    kept = (here > nearest) & (here < np.float32(1e9)) & (above > np.float32(jump**2) * here)
    if hidden is not None:
        kept &= ~(hidden[1::2, ::2] | hidden[: len(ground) // 2 * 2 : 2, ::2])
    rows, cols = (2 * of.astype(np.int32) for of in np.divmod(np.flatnonzero(kept), kept.shape[1]))
    rows += 1
    if len(rows) > most:
        some = np.linspace(0, len(rows) - 1, most).round().astype(np.intp)
        rows, cols = rows[some], cols[some]
    return rows, cols


def _contrast(rgb: UInt8Array, shrink: int) -> Float32Array:
    """Return how much the colour changes from above to below each place, relative to its surroundings' texture: two
    rows and the next two, as means over five columns, summed over the colours; 0 where there are none."""
    small = cv2.resize(rgb, (rgb.shape[1] // shrink, rgb.shape[0] // shrink), interpolation=cv2.INTER_AREA)
    below_less_above = np.repeat(np.array([[-1.0], [-1.0], [1.0], [1.0]]), 5, axis=1)
    five = cv2.filter2D(small, cv2.CV_32F, below_less_above, anchor=(2, 2), borderType=cv2.BORDER_REFLECT_101)
    red, green, blue = cv2.split(np.abs(five) * np.float32(0.2))
    change = np.asarray(red + green + blue, np.float32)
    change[[0, 1, -1]] = 0.0
    return np.asarray(np.minimum(change / (cv2.blur(change, (25, 25)) + 6.0), 4.0), np.float32)


def _scores(contrast: Float32Array, rows: Int32Array, cols: Int32Array, reach: int) -> Float32Array:
    """Return the mean contrast under the edges, shifted by -reach..reach rows and columns."""
    # Edges that leave the image count as no contrast: the rest must not look the better for it.
    wide = np.pad(contrast, reach)
    edges = np.zeros_like(contrast)
    inside = (rows < len(contrast)) & (cols < contrast.shape[1])
    np.add.at(edges, (rows[inside], cols[inside]), np.float32(1 / len(rows)))
    return np.asarray(cv2.matchTemplate(wide, edges, cv2.TM_CCORR), np.float32)
