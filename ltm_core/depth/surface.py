"""What the terrain lets expect of a pixel: the depth of the visible surface and how sure it is.

Traced depth is that of bare ground. Where a label says that something grows, the camera looks at its top: the ray that
meets a surface raised by h above ground of depth d is the one that meets bare ground h f / d pixels further down the
image. So the raised surface's depth is found in the traced image itself, exactly where the slope goes on, and never
across a silhouette (that is `silhouettes`' work).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.pose import Pose

Image = NDArray[np.float32]

JUMP = 1.25
"""Ratio of depths of neighbouring pixels from which on they lie on two surfaces."""
COVER_DOUBT = 0.5
"""Sigma of a cover height as a part of it."""
_PIXEL_DOUBT = 0.3
"""Pixels by which an edge of the terrain may be misplaced even with perfect pose: pixel grid and DEM cells."""
_LEAST = 1e-3
"""Least relative sigma that is ever claimed."""
_MOST_ROLL_DEG = 20.0


def expected_surface(
    ground: Image,
    labels: NDArray[np.uint8] | None,
    cover: NDArray[np.float32],
    camera: Camera,
    pose: Pose,
    angle_sigma: float,
    dem_sigma: float,
) -> tuple[Image, Image]:
    """Depth of the visible surface and its sigma, (H, W) float32 metres; +inf and NaN stay as they are in `ground`.

    Args:
        ground: traced depth along the optical axis (H, W).
        labels: class ids (H, W), or None: bare ground everywhere.
        cover: (256,) metres of cover above ground by class id.
        angle_sigma: of the camera's direction, radians.
        dem_sigma: of the terrain's heights, metres.

    Sigma follows from the traced depth's own gradient: what a pixel's neighbour above or below sees is what the pixel
    would see under another pitch, or over lower or higher ground. A camera rolled by more than 20 degrees gets no
    cover, since its columns are not plumb.
    """
    surface, sigma = np.empty_like(ground), np.empty_like(ground)
    _, pitch, roll = pose.angles_deg
    plumb = math.cos(math.radians(pitch)) if abs(roll) <= _MOST_ROLL_DEG else 0.0
    _expect(
        ground,
        np.zeros((1, 1), np.uint8) if labels is None else labels,
        labels is not None,
        (cover * plumb).astype(np.float32),
        np.float32(camera.fy),
        np.float32(angle_sigma),
        np.float32(dem_sigma),
        surface,
        sigma,
    )
    return surface, sigma


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def _expect(
    ground: Image,
    labels: NDArray[np.uint8],
    labelled: bool,
    cover: NDArray[np.float32],
    focal: np.float32,
    angle_sigma: np.float32,
    dem_sigma: np.float32,
    surface: Image,
    sigma: Image,
) -> None:
    height, width = ground.shape
    far = np.float32(1e9)
    jump = np.float32(JUMP)
    for v in range(height):
        up, down = max(v - 1, 0), min(v + 1, height - 1)
        for u in range(width):
            d = ground[v, u]
            surface[v, u] = d
            if not d < far:
                sigma[v, u] = np.float32(np.nan)
                continue
            c = d
            if labelled:
                h = cover[labels[v, u]]
                if h > 0:
                    reach = h * focal
                    place = v + reach / d
                    # Twice: the ground further down is nearer, so that the same height spans more pixels there.
                    for _ in range(2):
                        k = min(int(place), height - 2)
                        below = ground[k, u] + min(place - k, np.float32(1.0)) * (ground[k + 1, u] - ground[k, u])
                        if not below * jump > d:
                            break
                        c = below
                        place = v + reach / below
            # One-sided differences, the lesser of two: a silhouette beside the pixel is no slope.
            a, b = abs(ground[up, u] - d), abs(ground[down, u] - d)
            slope_v = min(a, b) if a > 0 and b > 0 else max(a, b)
            a, b = abs(ground[v, max(u - 1, 0)] - d), abs(ground[v, min(u + 1, width - 1)] - d)
            slope_u = min(a, b)
            if not slope_v < far:
                slope_v = np.float32(0.1) * d
            if not slope_u < far:
                slope_u = np.float32(0.0)
            across = np.float32(_PIXEL_DOUBT) / focal
            angle = angle_sigma * angle_sigma + across * across
            lift = dem_sigma / d
            least = np.float32(_LEAST) * d
            doubt = np.float32(COVER_DOUBT) * (d - c)
            square = slope_v * slope_v * (angle + lift * lift) + slope_u * slope_u * angle
            sigma[v, u] = np.sqrt(focal * focal * square + least * least + doubt * doubt)
            surface[v, u] = c
