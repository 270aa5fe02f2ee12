"""Detect values in another unit: angles of poses in radians or gon, heights of cameras and DEMs in feet.

An angle off the circle is an error. Possible but unlikely values give a warning in words; each bound states its rate of
false warnings.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Annotated

import numpy as np
from pydantic import AfterValidator

from ltm_core.base.types import Float32Array, Float64Array

FOOT = 0.3048
"""One foot in metres."""
TALLEST_MAST = 150.0
"""Height in metres above the ground above which a camera is suspicious. Fire-watch towers and masts are lower;
aircraft, and cameras at a cliff edge that a coarse DEM smooths, are not."""
_SLACK = 10.0
"""Metres by which a height in feet may still be below the ground; surveyed positions and DEMs differ by as much."""
_DEEP = 50.0
"""Metres below the ground that no datum and no coarse DEM explains."""


def _azimuth(value: float) -> float:
    if not -180.0 <= value <= 360.0:
        raise ValueError(
            f"an azimuth is 0 to 360 degrees clockwise from grid north, or -180 to 180, not {value:g}: convert gon, "
            "mils or tenths of a degree first"
        )
    return value


def _pitch(value: float) -> float:
    if not -90.0 <= value <= 90.0:
        raise ValueError(f"a pitch is -90 (straight down) to 90 degrees (straight up), not {value:g}")
    return value


def _roll(value: float) -> float:
    if not -180.0 <= value <= 180.0:
        raise ValueError(f"a roll is -180 to 180 degrees, not {value:g}")
    return value


AzimuthDeg = Annotated[float, AfterValidator(_azimuth)]
PitchDeg = Annotated[float, AfterValidator(_pitch)]
RollDeg = Annotated[float, AfterValidator(_roll)]


def doubt_of_radians(azimuths_deg: Collection[float]) -> str | None:
    """Return why the azimuths of a file may be in radians; None if they are plausible.

    They are doubted where all lie within 2 pi and one at least is no whole number. Of right azimuths, spread evenly,
    2 pi / 360 = 1.7 % lie there: one camera in 57 is doubted, of files with two cameras one in 3,300.
    """
    different = sorted(set(azimuths_deg))
    if not different or max(map(abs, different)) > 2 * math.pi or all(value == round(value) for value in different):
        return None
    last = different[-1] if different[-1] != round(different[-1]) else next(v for v in different if v != round(v))
    what = (
        f"azimuth {last:g} lies" if len(different) == 1 else f"all azimuths, {different[0]:g} to {different[-1]:g}, lie"
    )
    return (
        f"{what} within 2 pi, close to grid north: if these are radians, write degrees "
        f"({last:g} rad is {math.degrees(last) % 360:.1f} deg)"
    )


def doubt_of_height(z: float, ground: float) -> str | None:
    """Return why a camera's height `z` over `ground`, in metres, may be in feet or wrong; None if it is plausible.

    Warns of cameras TALLEST_MAST or more above the ground, and under it. NaN ground gives no warning.
    """
    above = z - ground
    if math.isnan(above) or 0.0 < above <= TALLEST_MAST:
        return None
    if above > 0 and -_SLACK <= z * FOOT - ground <= TALLEST_MAST:
        return (
            f"z = {z:g} m is {above:.0f} m above the ground ({ground:.0f} m); as feet it would be {z * FOOT:.0f} m: "
            "heights are metres in the DEM's vertical datum"
        )
    if above > 0:
        return f"z = {z:g} m is {above:.0f} m above the ground ({ground:.0f} m), higher than masts: check it"
    if -above > _DEEP and -_SLACK <= z - ground * FOOT <= TALLEST_MAST:
        return (
            f"z = {z:g} m is {-above:.0f} m under the ground ({ground:.0f} m); if the DEM's heights are feet, the "
            f"ground is at {ground * FOOT:.0f} m: convert the DEM to metres"
        )
    return (
        f"z = {z:g} m is {-above:.2f} m under the ground, which is at {ground:.2f} m: check its height, the vertical "
        "datum (ellipsoidal or geoid) and the position"
    )


HIGHEST, LOWEST = 8_900.0, -500.0
"""Highest and lowest ground on Earth in metres."""
_STEEP = 0.8
"""Maximum median slope along rows, in metres per metre. Half of the slopes in the Alps are below 0.45; with heights in
feet, below 1.5."""
_LEAST_CELLS = 50
_ALIKE = 0.08
"""Relative tolerance of a ratio of heights around that of feet to metres."""
_FAR_OFF = 50.0
"""Median difference in metres between two rasters of the same ground that no land datum explains, trees included."""


def doubt_of_dem(elevation: Float32Array, resolution: float) -> str | None:
    """Return why a DEM's heights (H, W) in metres may be in feet; None if they are plausible.

    Only mountains show it: hills in feet are as steep as mountains in metres.
    """
    low, high = float(np.nanmin(elevation)), float(np.nanmax(elevation))
    if high > HIGHEST or low < LOWEST:
        return (
            f"heights are {low:.0f} to {high:.0f} m, ground is {LOWEST:.0f} to {HIGHEST:.0f} m: convert feet to "
            "metres, and declare the value that stands for nodata"
        )
    rows = elevation[:: max(1, elevation.shape[0] // 500)]
    rise = np.abs(np.diff(rows, axis=1)) / resolution
    if resolution < 5.0 or not np.isfinite(rise).any() or float(np.nanmedian(rise)) <= _STEEP:
        return None
    return (
        f"half of the ground is steeper than {math.degrees(math.atan(float(np.nanmedian(rise)))):.0f} degrees: if its "
        "heights are feet, convert them to metres"
    )


def doubt_of_heights(heights: Float64Array, others: Float64Array, name: str) -> str | None:
    """Return why heights in metres do not match those of another raster of the same places, called `name`; None if they
    do, or if too few are known in both."""
    known = np.isfinite(heights) & np.isfinite(others) & (np.abs(others) > 20) & (np.abs(heights) > 20)
    if known.sum() < _LEAST_CELLS:
        return None
    ratio = float(np.median(heights[known] / others[known]))
    apart = float(np.median(np.abs(heights[known] - others[known])))
    if abs(ratio * FOOT - 1) < _ALIKE:
        return f"is {ratio:.2f} times as high as {name}: its heights are feet, convert them to metres"
    if abs(ratio / FOOT - 1) < _ALIKE:
        return f"is {ratio:.2f} times as high as {name}, whose heights may be feet: convert them to metres"
    if apart > _FAR_OFF:
        return f"is {apart:.0f} m off {name} in the median: check place, unit and datum of both"
    return None
