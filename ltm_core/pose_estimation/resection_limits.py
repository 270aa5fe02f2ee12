"""Requirements of a resection on its control points, and which parameters the points can determine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ltm_core.camera import Camera
from ltm_core.errors import PoseError
from ltm_core.pose_estimation.control_points import ControlPoints
from ltm_core.pose_estimation.resection_adjustment import (
    MIN_REDUNDANCY,
    REMEDY,
    SIZE,
    Fit,
    Parameter,
    diagonal,
    median_px,
    named,
    size_of,
)
from ltm_core.types import Float64Array

MAX_MEDIAN_SHARE = 0.02
"""Median residual over the image's diagonal above which no pose explains the points."""
MAX_ANGLE_SIGMA_DEG = 1.0
MAX_FOCAL_SIGMA = 0.03
"""Share of the focal length."""
MAX_K1_SHIFT = 0.01
"""Share of the image's diagonal: what one sigma of k1 moves at the image's corner."""
MAX_POSITION_SIGMA = 0.02
"""Share of the median distance of the points."""


def check_points(points: ControlPoints, camera: Camera, position: Float64Array) -> None:
    names = np.array(points.names)
    if len(names) < 3:
        raise PoseError(f"resection needs at least 3 control points, got {len(names)}: {', '.join(names) or 'none'}")
    if position.shape != (3,) or not np.isfinite(position).all():
        raise PoseError(f"the camera's position must be three finite metres, got {position.tolist()}")
    u, v = points.pixels.T
    outside = (u < -0.5) | (v < -0.5) | (u > camera.width - 0.5) | (v > camera.height - 0.5)
    if outside.any():
        at = ", ".join(f"{n} ({a:g}, {b:g})" for n, a, b in zip(names[outside], u[outside], v[outside], strict=True))
        raise PoseError(
            f"control points outside the image of {camera.width} x {camera.height} pixels: {at}; is the calibration "
            "that of this image size, are u (column) and v (row) in their order, are pixels counted from 0 or 1?"
        )
    near = np.linalg.norm(points.places - position, axis=1) < 1.0
    if near.any():
        raise PoseError(f"control points within 1 m of the camera: {', '.join(names[near])}; check the position")


def hold_for_redundancy(chosen: list[Parameter], count: int, prior: bool) -> dict[Parameter, str]:
    """Take parameters out of `chosen` that so few points cannot fit, k1 first."""
    held: dict[Parameter, str] = {}
    for name in ("k1", "position", "focal"):
        observed = 2 * count + (3 if prior and "position" in chosen else 0)
        needed = 3 + size_of(tuple(chosen)) + MIN_REDUNDANCY
        if observed >= needed:
            break
        if name in chosen:
            chosen.remove(name)
            held[name] = f"{count} points are too few to fit it: {(needed + 1) // 2} are needed"
    return held


def check_fit(points: ControlPoints, fit: Fit) -> None:
    limit = MAX_MEDIAN_SHARE * diagonal(fit.camera)
    median = median_px(fit.residuals)
    if median > limit:
        raise PoseError(
            f"no pose explains the control points: the median residual is {median:.0f} px (limit {limit:.0f} px): "
            f"{named(points, fit.residuals, np.ones(len(points.names), bool))}. {REMEDY}"
        )


def unbearable(
    fit: Fit, free: tuple[Parameter, ...], points: ControlPoints, forced: Sequence[Parameter] = ()
) -> tuple[Parameter, str] | None:
    """The free parameter that the points bear least, and why; None where they bear all but those that are `forced`.
    Raises for the angles.
    """
    camera = fit.camera
    sigma = np.sqrt(np.diag(fit.covariance))
    sights = points.places[fit.used] - fit.pose.position
    distance = float(np.median(np.linalg.norm(sights, axis=1)))
    worst: tuple[float, Parameter, str] | None = None
    at = 3
    for name in free:
        own = float(sigma[at : at + SIZE[name]].max())
        at += SIZE[name]
        if name == "focal":
            excess, reason = own / MAX_FOCAL_SIGMA, f"its sigma would be {own:.1%} (limit {MAX_FOCAL_SIGMA:.0%})"
        elif name == "k1":
            corner = _corner_radius(camera)
            shift = own * corner**3 * camera.fx
            limit = MAX_K1_SHIFT * diagonal(camera)
            excess = shift / limit
            reason = f"its sigma would be {own:.2g}, {shift:.0f} px at the image's corner (limit {limit:.0f} px)"
        else:
            limit = MAX_POSITION_SIGMA * distance
            excess = own / limit
            reason = f"its sigma would be {own:.3g} m (limit {limit:.3g} m, {MAX_POSITION_SIGMA:.0%} of the distance)"
            if _in_line(points.places[fit.used]):
                reason += "; the points lie in one line"
        if name not in forced and excess > 1 and (worst is None or excess > worst[0]):
            worst = excess, name, f"{reason}: mark points that differ more in distance and place in the image"
    if worst is not None:
        return worst[1], worst[2]
    turn = float(np.degrees(np.sqrt(np.linalg.eigvalsh(fit.covariance[:3, :3]).max())))
    if turn <= MAX_ANGLE_SIGMA_DEG:
        return None
    loose = [name for name in free if name not in forced]
    if loose:
        name = "position" if "position" in loose else loose[-1]
        return name, f"with it the angles' sigma would be {turn:.2g} degrees (limit {MAX_ANGLE_SIGMA_DEG:g})"
    if free:
        return None
    raise PoseError(
        f"the camera's angles do not follow from the control points {', '.join(points.names)}: sigma {turn:.2g} "
        f"degrees (limit {MAX_ANGLE_SIGMA_DEG:g}); mark points further apart in the image, and check their pixels"
    )


def _in_line(places: Float64Array) -> bool:
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 0.02 * spread[0])


def _corner_radius(camera: Camera) -> float:
    """Of the corner farthest from the principal point, in focal lengths."""
    x = max(camera.cx, camera.width - 1 - camera.cx) / camera.fx
    y = max(camera.cy, camera.height - 1 - camera.cy) / camera.fy
    return float(np.hypot(x, y))
