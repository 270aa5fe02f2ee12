"""Invert the distortion of a lens: from pixels to viewing rays. `Camera.rays` is the way in."""

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float64Array


@helper()
def _radial_inverse(distorted: float, k1: float, k2: float, k3: float, fold: float) -> float:
    """Return the undistorted radius of a distorted one, by bisection: up to the fold the radial model only grows."""
    low, high = 0.0, np.sqrt(fold)
    if not np.isfinite(high):
        high = 1.0
        while high < 1e6 and high * (1 + high**2 * (k1 + high**2 * (k2 + high**2 * k3))) < distorted:
            high *= 2
    for _ in range(60):
        middle = (low + high) / 2
        s = middle * middle
        if middle * (1 + s * (k1 + s * (k2 + s * k3))) < distorted:
            low = middle
        else:
            high = middle
    middle = (low + high) / 2
    return float(middle)


@kernel(nogil=True)
def undistorted_rays(
    first: int, end: int, rays: Float64Array, intrinsics: Float64Array, distortion: Float64Array, fold: float
) -> None:
    """Invert the two distortion equations by Newton's method in rows `first` to `end` of `rays` (H, W, 3); a
    pixel that does not converge inside the fold is NaN.

    It starts at the distorted point. Where the model all but folds, steps from there may never settle; then a second
    start, at the radius that the radial part alone gives, lies next to the solution."""
    fx, fy, cx, cy = intrinsics
    k1, k2, p1, p2, k3 = distortion
    width = rays.shape[1]
    for v in range(first, end):
        for u in range(width):
            xd, yd = (u - cx) / fx, (v - cy) / fy
            x, y = xd, yd
            residual = np.inf
            for step in range(100):
                if step == 50:
                    scale = _radial_inverse(np.hypot(xd, yd), k1, k2, k3, fold) / np.hypot(xd, yd)
                    x, y = xd * scale, yd * scale
                r2 = x * x + y * y
                radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
                slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # d radial / d r2
                ex = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - xd
                ey = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - yd
                residual = abs(ex) + abs(ey)
                if residual < 1e-14:
                    break
                a = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
                b = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
                d = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
                det = a * d - b * b
                x -= (d * ex - b * ey) / det
                y -= (a * ey - b * ex) / det
            if residual < 1e-9 and x * x + y * y <= fold:
                norm = np.sqrt(x * x + y * y + 1)
                rays[v, u, 0], rays[v, u, 1], rays[v, u, 2] = x / norm, y / norm, 1 / norm
            else:
                rays[v, u, :] = np.nan
