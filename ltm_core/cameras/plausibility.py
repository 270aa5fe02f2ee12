"""Detect values in another unit: angles of poses in radians or gon, heights of cameras in feet.

An angle off the circle is an error; possible but unlikely values give a warning in words."""

import math
from collections.abc import Collection
from typing import Annotated

from pydantic import AfterValidator

FOOT = 0.3048
"""One foot in metres."""
TALLEST_MAST = 150.0
"""Height in metres above the ground above which a camera is suspicious. Fire-watch towers and masts are lower;
aircraft, and cameras at a cliff edge that a coarse DEM smooths, are not."""
_SLACK = 10.0
"""Metres by which a height in feet may still be below the ground; surveyed positions and DEMs differ by as much."""
_DEEP = 50.0
"""Metres below the ground that no datum and no coarse DEM explains."""


def _within(low: float, high: float, what: str) -> AfterValidator:
    def checked(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(what.format(value))
        return value

    return AfterValidator(checked)


_AZIMUTH = "an azimuth is 0 to 360 (or -180 to 180) degrees from grid north, not {:g}: convert gon or mils first"
_PITCH = "a pitch is -90 (straight down) to 90 degrees (straight up), not {:g}"
AzimuthDeg = Annotated[float, _within(-180.0, 360.0, _AZIMUTH)]
PitchDeg = Annotated[float, _within(-90.0, 90.0, _PITCH)]
RollDeg = Annotated[float, _within(-180.0, 180.0, "a roll is -180 to 180 degrees, not {:g}")]


def doubt_of_radians(azimuths_deg: Collection[float]) -> str | None:
    """Return why the azimuths of a file may be in radians; None if they are plausible.

    They are doubted where all lie within 2 pi and one at least is no whole number. Of right azimuths, spread evenly,
    2 pi / 360 = 1.7 % lie there: one camera in 57 is doubted, of files with two cameras one in 3,300."""
    different = sorted(set(azimuths_deg))
    if not different or max(map(abs, different)) > 2 * math.pi or all(value == round(value) for value in different):
        return None
    odd = next(value for value in reversed(different) if value != round(value))
    return (
        f"azimuths from {different[0]:g} to {different[-1]:g} lie within 2 pi, close to grid north: if these are "
        f"radians, write degrees ({odd:g} rad is {math.degrees(odd) % 360:.1f} deg)"
    )


def doubt_of_height(z: float, ground: float) -> str | None:
    """Return why a camera's height `z` over `ground`, in metres, may be in feet or wrong; None if it is plausible.

    Warns of cameras TALLEST_MAST or more above the ground, and under it. NaN ground gives no warning."""
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
