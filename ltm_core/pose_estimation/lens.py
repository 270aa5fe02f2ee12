"""State what is known of a lens before it is fitted, and test whether residuals bend with the radius.

The corner shares are 1.5 to 4 robust standard deviations of the lensfun database (lensfunpy 1.18, focal lengths of 15
to 90 mm at 35 mm: 2,223 calibrations of interchangeable lenses 0.033, 1,230 of compact cameras 0.040, 7 of action
cameras 0.126 about -0.117, 8 of phones 0.035), because its lenses have a known maker. Lenses of fire-watch cameras are
in no database; the surveyed webcam of Finse shifts corners by 15 %."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera

RADIAL = {"k1": 0, "k2": 1, "k3": 4}  # places of the radial terms in `Camera.distortion`
_KINDS = {"phone": 0.04, "slr": 0.05, "ptz": 0.1, "action": 0.25, "any": 0.15}
"""Standard deviation of the radial shift at an image's corner, as a share of its radius, by kind of lens."""
_FOCAL = {"phone": 0.02, "slr": 0.02, "ptz": 0.05, "action": 0.05, "any": 0.05}
"""Relative standard deviation of the focal length by kind of lens."""
_HIGHER = 0.5  # standard deviation of each higher radial term, as a share of that of the term before it, at the corner
_CENTRE = 0.005  # standard deviation of the principal point as a share of the image's width


@dataclass(frozen=True)
class LensPrior:
    """Standard deviations of a lens about its stated calibration: `focal` (relative), k1, k2, k3, `centre` (pixels)."""

    stated: Camera
    focal: float
    k1: float
    k2: float
    k3: float
    centre: float

    @classmethod
    def of(cls, kind: str, stated: Camera) -> "LensPrior":
        """Return the prior of a kind of lens about its stated calibration. Raises PoseError for another kind."""
        if kind not in _KINDS:
            raise PoseError(f"lens:{kind} is not a kind of lens; give one of {', '.join(_KINDS)}")
        square = corner_radius(stated) ** 2
        k1 = _KINDS[kind] / square
        k2 = _HIGHER * k1 / square
        return cls(stated, _FOCAL[kind], k1, k2, _HIGHER * k2 / square, _CENTRE * stated.width)

    def deviations(self, camera: Camera) -> dict[str, tuple[float, ...]]:
        """Return by parameter the deviations of a camera from the stated one, in standard deviations."""
        stated = self.stated
        found: dict[str, tuple[float, ...]] = {
            "focal": (float(np.log(camera.fx / stated.fx)) / self.focal,),
            "centre": ((camera.cx - stated.cx) / self.centre, (camera.cy - stated.cy) / self.centre),
        }
        for name, at in RADIAL.items():
            found[name] = ((camera.distortion[at] - stated.distortion[at]) / getattr(self, name),)
        return found


def corner_radius(camera: Camera) -> float:
    """Return the radius, in focal lengths, of the image corner that is farthest from the principal point."""
    x = max(camera.cx, camera.width - 1 - camera.cx) / camera.fx
    y = max(camera.cy, camera.height - 1 - camera.cy) / camera.fy
    return float(np.hypot(x, y))


@dataclass(frozen=True)
class RadialTrend:
    """Estimate `k` of a radial term from residuals, with its standard deviation."""

    k: float
    sigma: float

    @property
    def clear(self) -> bool:
        """Return whether the residuals bend with the radius."""
        return abs(self.k) > 4.0 * self.sigma


def radial_trend(errors: Float64Array, fitted: Float64Array, by_k: Float64Array, sigma: Float64Array) -> RadialTrend:
    """Return the radial term that explains residuals beyond what the fitted parameters could.

    `errors`: (N,) pixels; `fitted`: (N, P) their slopes by the fitted parameters; `by_k`: (N,) by the radial term;
    `sigma`: (N,) smallest standard deviations. Least squares over the part of `by_k` orthogonal to `fitted`; the
    scale is that of the misfits that remain."""
    rows = np.column_stack([fitted, by_k]) / sigma[:, None]
    scales = np.linalg.norm(rows, axis=0)
    scales[scales == 0] = 1.0
    target = errors / sigma
    basis, rest = np.linalg.qr(rows / scales)
    if abs(rest[-1, -1]) < 1e-6:  # the fitted parameters can do the same
        return RadialTrend(0.0, np.inf)
    k = float(basis[:, -1] @ target / rest[-1, -1] / scales[-1])
    left = target - basis @ (basis.T @ target)
    spread = float(np.sqrt(left @ left / max(len(target) - rows.shape[1], 1)))
    return RadialTrend(k, max(spread, 1.0) / abs(float(rest[-1, -1]) * scales[-1]))
