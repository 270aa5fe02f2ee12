"""A zoom lens: the camera at each zoom, from a table of fields of view."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.errors import CameraError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera

_BESIDE = 0.02
"""Share of the table's span by which a zoom may exceed it, because end stops are not exact."""

ALERTCALIFORNIA_ZOOM = (
    (1.0, 62.6), (34.0, 56.8), (97.0, 48.3), (257.0, 34.9), (646.0, 20.9), (1606.0, 10.5), (3602.0, 5.2), (9905.0, 2.3),
)  # fmt: skip
"""(VAPIX zoom, horizontal field of view in degrees), from the corners of fields of view that ALERTCalifornia publishes
for its PTZ cameras. Use it for such a camera if nothing better is known, and calibrate it."""


class ZoomPoint(StrictModel):
    """Lens at one zoom."""

    zoom: float
    """Zoom in the camera's own unit."""
    hfov_deg: float = Field(gt=0, lt=180)
    """Horizontal field of view in degrees between the image's left and right edges, without distortion."""
    k1: float = 0.0
    """First radial distortion after Brown and Conrady."""
    k2: float = 0.0
    """Second radial distortion."""
    p1: float = 0.0
    """First tangential distortion."""
    p2: float = 0.0
    """Second tangential distortion."""
    k3: float = 0.0
    """Third radial distortion."""


class LensConfig(StrictModel):
    """Zoom lens, in pixels of the upright image."""

    width: int = Field(gt=0)
    """Width of the image in pixels."""
    height: int = Field(gt=0)
    """Height of the image in pixels."""
    cx: float | None = None
    """Column of the principal point in pixels; default: the image's centre."""
    cy: float | None = None
    """Row of the principal point in pixels; default: the image's centre."""
    zoom: tuple[ZoomPoint, ...] = Field(
        tuple(ZoomPoint(zoom=zoom, hfov_deg=hfov) for zoom, hfov in ALERTCALIFORNIA_ZOOM), min_length=1
    )
    """Table from wide to long; with one point, the lens does not zoom."""

    @model_validator(mode="after")
    def _wide_to_long(self) -> Self:
        for a, b in zip(self.zoom, self.zoom[1:], strict=False):
            if not (a.zoom < b.zoom and a.hfov_deg > b.hfov_deg):
                raise ValueError(
                    f"the field of view must fall with zoom: {a.zoom:g} with {a.hfov_deg:g} deg and {b.zoom:g} with "
                    f"{b.hfov_deg:g} deg"
                )
        return self

    def lens(self) -> "ZoomLens":
        cx = (self.width - 1) / 2 if self.cx is None else self.cx
        cy = (self.height - 1) / 2 if self.cy is None else self.cy
        table = tuple((p.zoom, p.hfov_deg, p.k1, p.k2, p.p1, p.p2, p.k3) for p in self.zoom)
        return ZoomLens(self.width, self.height, cx, cy, table)


@dataclass(frozen=True)
class ZoomLens:
    """Intrinsics at each zoom.

    `table`: rows of zoom, horizontal field of view (deg), k1, k2, p1, p2, k3, from wide to long. Between them log
    tan(hfov / 2) and the distortion are interpolated by monotone cubics over log(zoom - wide + c). c is such that a
    lens of tan(hfov / 2) = a / (1 + b (zoom - wide)), as most are over most of their range, is met exactly."""

    width: int
    height: int
    cx: float
    cy: float
    table: tuple[tuple[float, ...], ...]
    aspect: float = 1.0
    """Ratio of fy to fx for pixels that are not square."""

    @classmethod
    def fixed(cls, camera: Camera) -> Self:
        """Return the lens of a camera that does not zoom."""
        row = (0.0, _hfov_deg(camera.width, camera.fx), *camera.distortion)
        return cls(camera.width, camera.height, camera.cx, camera.cy, (row,), camera.fy / camera.fx)

    def camera(self, zoom: float) -> Camera:
        """Return the camera at a zoom. Raises CameraError outside the table."""
        first, last = self.table[0][0], self.table[-1][0]
        slack = _BESIDE * (last - first)
        if len(self.table) > 1 and not first - slack <= zoom <= last + slack:
            raise CameraError(
                f"zoom {zoom:g} lies outside the lens's table, {first:g} to {last:g}: add it to `mount.lens.zoom` of "
                "the site file"
            )
        return _camera(self, min(max(zoom, first), last))

    def scaled(self, factors: Mapping[float, float], bends: Mapping[float, float] = {}) -> "ZoomLens":
        """Return the lens with focal lengths multiplied by factors at some zooms, and `bends` added to k1 there,
        interpolated between these and constant beyond. The zooms of `factors` become rows of the table."""
        if not factors:
            return self
        known = sorted(factors)
        rows = []
        for zoom in sorted({row[0] for row in self.table} | (set(known) if len(self.table) > 1 else set())):
            camera = self.camera(zoom)
            at = self._measure(np.array([zoom, *known]))
            factor = math.exp(float(np.interp(at[0], at[1:], np.log([factors[k] for k in known]))))
            k1 = camera.distortion[0] + float(np.interp(at[0], at[1:], [bends.get(k, 0.0) for k in known]))
            rows.append((zoom, _hfov_deg(self.width, camera.fx * factor), k1, *camera.distortion[1:]))
        return replace(self, table=tuple(rows))

    def config(self) -> LensConfig:
        points = tuple(
            ZoomPoint(zoom=zoom, hfov_deg=round(hfov, 4), k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
            for zoom, hfov, k1, k2, p1, p2, k3 in self.table
        )
        return LensConfig(width=self.width, height=self.height, cx=self.cx, cy=self.cy, zoom=points)

    @cached_property
    def _log_tangents(self) -> Float64Array:
        return np.log(np.tan(np.radians([row[1] for row in self.table]) / 2))

    def _measure(self, zoom: Float64Array) -> Float64Array:
        if len(self.table) < 2:
            return np.asarray(zoom, np.float64)
        first, last = self.table[0][0], self.table[-1][0]
        ratio = math.exp(self._log_tangents[0] - self._log_tangents[-1])
        return np.asarray(np.log(np.asarray(zoom) - first + (last - first) / (ratio - 1)), np.float64)

    def values(self, zoom: float) -> tuple[float, Float64Array]:
        """Return the focal length (pixels) and distortion (5,) at a zoom within the table."""
        rows = np.array(self.table)
        if len(rows) == 1:
            log_tangent, distortion = float(self._log_tangents[0]), rows[0, 2:]
        else:
            # Loaded where a lens zooms: 0.1 s of each process that reads a site.
            from scipy.interpolate import PchipInterpolator

            at = self._measure(rows[:, 0])
            both = PchipInterpolator(at, np.column_stack([self._log_tangents, rows[:, 2:]]))
            found = both(self._measure(np.array([zoom])))[0]
            log_tangent, distortion = float(found[0]), found[1:]
        return self.width / 2 / math.exp(log_tangent), np.asarray(distortion, np.float64)


def _hfov_deg(width: int, fx: float) -> float:
    return math.degrees(2 * math.atan(width / 2 / fx))


@lru_cache(maxsize=256)
def _camera(lens: ZoomLens, zoom: float) -> Camera:
    focal, (k1, k2, p1, p2, k3) = lens.values(zoom)
    distortion = (float(k1), float(k2), float(p1), float(p2), float(k3))
    return Camera(lens.width, lens.height, focal, focal * lens.aspect, lens.cx, lens.cy, distortion)
