"""Whether the terrain lies where the photo has it: traced silhouettes against the photo's edges.

A camera turned by half a degree moves every silhouette by the same some pixels. The traced silhouettes are shifted over
the photo's vertical gradient; where they meet clearly more contrast at some distance than where they are, the pose is
suspected. Cover on crests moves edges up by a few metres only, which is allowed for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.depth.surface import JUMP

REACH_DEG = 2.5
"""How far a wrong pose is looked for."""
_CELLS = 480  # of the contrast image in a row
_LEAST_EDGES = 60
_MOST_EDGES = 1500
_ALLOWED_DEG = 0.25  # DEM cells and crests' cover displace silhouettes even with a perfect pose
_COVER = 1.0  # metres that cover raises a crest by
_CLEARLY = 1.25  # ratio of the contrasts at the best and at the nearest place


@dataclass(frozen=True)
class PoseCheck:
    """`edges`: silhouettes looked at. `pitch_deg`, `azimuth_deg`: by how much the camera should be turned (up,
    clockwise) for the terrain to fit the photo best, 0 where not known. `gain`: contrast met there over that met
    without a turn. `suspected`, and `reason` in words.
    """

    edges: int
    pitch_deg: float
    azimuth_deg: float
    gain: float
    suspected: bool
    reason: str


def check_pose(
    rgb: NDArray[np.uint8], ground: NDArray[np.float32], camera: Camera, angle_sigma: float, dem_sigma: float
) -> PoseCheck:
    """Check one photo (H, W, 3) against its traced depth (H, W).

    `angle_sigma`, `dem_sigma`: radians and metres that are no surprise. Near crests say nothing, since a metre of cover
    or of the DEM's error moves them by as much as a wrong pose would.
    """
    rows, cols = _silhouettes(ground, (_COVER + 2 * dem_sigma) / math.radians(_ALLOWED_DEG))
    count = len(rows)
    if count < _LEAST_EDGES:
        return PoseCheck(count, 0.0, 0.0, 1.0, False, "")
    shrink = max(1, round(rgb.shape[1] / _CELLS))  # photo pixels a cell
    contrast = _contrast(rgb, shrink)
    reach = int(math.radians(REACH_DEG) * camera.fy / shrink)
    scores = _scores(contrast, rows // shrink, cols // shrink, reach)
    allowed = (math.radians(_ALLOWED_DEG) + 3 * angle_sigma) * camera.fy / shrink
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    here = float(scores[np.hypot(v, u) <= allowed].max())
    best = np.unravel_index(int(np.argmax(scores)), scores.shape)
    down, right = int(best[0]) - reach, int(best[1]) - reach
    gain = float(scores[best]) / max(here, 1e-9)
    pitch = math.degrees(down * shrink / camera.fy)
    azimuth = -math.degrees(right * shrink / camera.fx)
    suspected = bool(gain > _CLEARLY and math.hypot(down, right) > allowed)
    reason = (
        f"the photo's edges fit the terrain's silhouettes {gain:.2f} times better with the camera turned by "
        f"{pitch:+.2f} deg of pitch and {azimuth:+.2f} deg of azimuth"
        if suspected
        else ""
    )
    return PoseCheck(count, pitch, azimuth, gain, suspected, reason)


def _silhouettes(ground: NDArray[np.float32], nearest: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels (rows, cols) above which is sky or ground farther by twice a jump, every other column, of ground beyond
    `nearest` metres; where known ground merely ends there is no edge to be seen.
    """
    near, above = ground[1::2, ::2], ground[:-1:2, ::2]
    with np.errstate(invalid="ignore"):
        edge = np.isfinite(near) & (near > nearest) & (above > JUMP * JUMP * near)
    rows, cols = np.nonzero(edge)
    if len(rows) > _MOST_EDGES:
        kept = np.linspace(0, len(rows) - 1, _MOST_EDGES).round().astype(np.intp)
        rows, cols = rows[kept], cols[kept]
    return 2 * rows + 1, 2 * cols


def _contrast(rgb: NDArray[np.uint8], shrink: int) -> NDArray[np.float32]:
    """How much the colour changes from above to below each place, relative to its surroundings' texture."""
    size = (rgb.shape[1] // shrink, rgb.shape[0] // shrink)
    small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float32)
    wide = cv2.blur(small, (5, 1))
    change = np.zeros(small.shape[:2], np.float32)
    change[2:-1] = np.abs(wide[2:-1] + wide[3:] - wide[1:-2] - wide[:-3]).sum(axis=2)
    texture = cv2.blur(change, (25, 25))
    return np.asarray(np.minimum(change / (texture + 6.0), 4.0), np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _scores(
    contrast: NDArray[np.float32], rows: NDArray[np.int64], cols: NDArray[np.int64], reach: int
) -> NDArray[np.float32]:
    """Mean contrast under the edges, shifted by -reach..reach rows and columns."""
    height, width = contrast.shape
    scores = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    for i in range(2 * reach + 1):
        for j in range(2 * reach + 1):
            total = np.float32(0.0)
            for k in range(len(rows)):
                r, c = rows[k] + i - reach, cols[k] + j - reach
                if 0 <= r < height and 0 <= c < width:
                    total += contrast[r, c]
            # Edges that leave the image count as no contrast: the rest must not look the better for it.
            scores[i, j] = total / len(rows)
    return scores
