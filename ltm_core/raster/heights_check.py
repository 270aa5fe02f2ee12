"""Decide what the numbers of an elevation raster mean: which band, which unit, which values are no ground.

Every raster of heights passes here when it is opened, whatever the command, and whether it is the finest one, a coarser
one or the surface. What cannot be right is a RasterError; what may be wrong is a `HeightsDoubt`."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float32Array, Float64Array

HIGHEST, LOWEST = 8_900.0, -500.0
"""Highest and lowest ground on Earth in metres."""
_DEEPEST = -11_000.0
"""Lowest sea floor in metres; some coastal rasters have it."""
_APART = 100.0
"""Distance in metres from all other heights beyond which one impossible value is a mark for nodata, or an outlier."""
_MOST_ODD = 1_000
"""Maximum number of different impossible values that are searched for marks."""
_MOST_MARKS = 4
"""Maximum number of marks in one raster."""
_STEEP, _TOO_STEEP = 0.8, 3.0
"""Median slopes along rows in metres per metre, above which heights may be, and are, in another unit. In the Alps it is
0.45; with heights in feet, 1.5; in decimetres, 4.5."""
_SMOOTH = 5.0
"""Least cell size in metres for these bounds."""
_LEAST_CELLS = 50
_ALIKE = 0.08
"""Relative tolerance of the ratio of two units."""
_FAR_OFF = 50.0
"""Median difference in metres between two rasters of the same ground that no land datum explains, trees included."""
_US_FOOT = 1200 / 3937
_UNITS = {
    r"us[ _-]?(survey[ _])?(ft|foot|feet)|(ft|foot|feet)[ _(-]*us|sft|survey[ _](foot|feet)": _US_FOOT,
    r"(international[ _])?(ft|foot|feet)": 0.3048,
    r"m|met(er|re)s?": 1.0,
    r"mm|millimet(er|re)s?": 0.001,
    r"cm|centimet(er|re)s?": 0.01,
    r"dm|decimet(er|re)s?": 0.1,
    r"km|kilomet(er|re)s?": 1000.0,
}
"""Size in metres of each unit, by its spellings."""
_HEIGHT_WORDS = (
    r"elev\w*|dem|dtm|dsm|dhm|heights?|hgt|alt|altitude|z|ground|topo\w*|terrain|surface|bathymetry|orthometric"
)
_OTHER_WORDS = (
    r"hill ?shad\w*|shad\w*|slope|slp|aspect|asp|densit\w*|intensity|uncertaint\w*|roughness|tri|tpi|curvature|"
    r"canopy (height|cover|base|bulk|closure|density)|above ground|agl|hag|chm|ndsm|cover|fbfm\w*|fuel\w*|count|std\w*|"
    r"sigma|errors?|quality|mask|red|green|blue|ndvi|class\w*|flow"
)


@dataclass(frozen=True)
class HeightsDoubt:
    """Result of a check of heights. `code`: the kind, such as "unit" or "nodata". `text`: what is found and what to do.
    `wrong`: the heights cannot be used."""

    code: str
    text: str
    wrong: bool = False

    def required(self) -> "HeightsDoubt":
        """Return the doubt. Raises RasterError if the heights cannot be used."""
        if self.wrong:
            raise RasterError(self.text)
        return self


def elevation_band(source: Any, path: Path | str) -> tuple[int, list[HeightsDoubt]]:
    """Return the number of the band with elevations: by its description, else the first. Raises RasterError for a file
    that states other things, or colours."""
    from rasterio.enums import ColorInterp

    names = [re.sub(r"[_\W]+", " ", name or "").strip() for name in source.descriptions]
    other = [re.search(rf"\b({_OTHER_WORDS})\b", name, re.IGNORECASE) is not None for name in names]
    stated = [re.search(rf"\b({_HEIGHT_WORDS})\b", name, re.IGNORECASE) is not None for name in names]
    colours = source.colorinterp
    data = [i for i, colour in enumerate(colours) if colour != ColorInterp.alpha]
    heights = [i for i in data if stated[i] and not other[i]]
    open_ = [i for i in data if not other[i]]
    if not heights and {ColorInterp.palette, ColorInterp.red, ColorInterp.hue} & set(colours):
        raise RasterError(
            f"{path}: its bands are colours ({', '.join(colour.name for colour in colours)}), not heights: give the "
            "elevations from which it was drawn, or decode it (terrain-RGB: -10000 + 0.1 (65536 R + 256 G + B))"
        )
    if not heights and not open_:
        raise RasterError(f"{path}: its bands are {', '.join(name or '?' for name in names)}, none of them elevation")
    doubts = []
    chosen = heights or open_
    if len(chosen) > 1:
        text = f"{path}: {len(chosen)} of its bands may be elevation; band {chosen[0] + 1} is taken as such"
        doubts.append(HeightsDoubt("band", text))
    return chosen[0] + 1, doubts


def unit_of(source: Any, band: int, vertical: float | None, path: Path | str) -> float:
    """Return the unit of a band in metres, as it or its CRS (`vertical`) states. Raises RasterError for a unit that is
    no length, and for a band that contradicts its CRS."""
    if np.issubdtype(np.dtype(source.dtypes[band - 1]), np.complexfloating):
        raise RasterError(f"{path}: band {band} is {source.dtypes[band - 1]}; elevation must be a real number")
    stated = (source.units[band - 1] or "").strip(" []()")
    if stated.lower() in ("", "unknown", "none", "n/a"):
        return 1.0 if vertical is None else vertical
    size = next(
        (size for word, size in _UNITS.items() if re.match(rf"({word})(?=$|[ ,;()])", stated, re.IGNORECASE)), None
    )
    if size is None:
        raise RasterError(f"{path}: band {band} is in {stated}, not a unit of height; give the raster of elevations")
    if vertical is not None and abs(size / vertical - 1) > 1e-4:
        raise RasterError(
            f"{path}: band {band} is in {stated}, but the heights of its CRS are in units of {vertical:.4g} m: correct "
            "one of them (gdal_edit -a_srs)"
        )
    return size


def clean_heights(heights: Float32Array, resolution: float, path: Path | str) -> list[HeightsDoubt]:
    """Replace values of heights (H, W) in metres that mark nodata by NaN, in place; return what may be wrong.

    `resolution`: cell size in metres. Raises RasterError for other heights that no ground has."""
    odd: set[float] = set()
    lowest, highest, nearest, zero = math.inf, -math.inf, math.inf, False  # nearest: to 0, apart from 0 itself
    for strip in _strips(heights):
        strange = (strip < LOWEST) | (strip > HIGHEST)
        if strange.any() and len(odd) <= _MOST_ODD:
            odd.update(np.unique(strip[strange])[: _MOST_ODD + 1].tolist())
        ground = strip[~strange & ~np.isnan(strip)]
        lowest, highest = float(ground.min(initial=lowest)), float(ground.max(initial=highest))
        nearest = float(np.abs(ground).min(initial=nearest, where=ground != 0))
        zero = zero or not ground.all()
    marks = _marks(odd, lowest, highest) | ({0.0} if zero and _APART < nearest < math.inf else set())
    doubts, counts = [], dict.fromkeys(sorted(marks), 0)
    for strip in _strips(heights) if marks else ():
        for value in counts:
            counts[value] += int((strip == np.float32(value)).sum())
            strip[strip == np.float32(value)] = np.nan
    if marks:
        told = ", ".join(f"{value:.6g} ({cells} cells)" for value, cells in counts.items())
        text = f"{path}: {told} cannot be ground there and is taken as nodata; declare it (gdal_edit -a_nodata)"
        doubts.append(HeightsDoubt("nodata", text))
    if odd - marks:
        doubts.append(_impossible(heights, odd - marks, resolution, path).required())
    return doubts


def _marks(values: set[float], lowest: float, highest: float) -> set[float]:
    """Return the impossible values that mark nodata: few, and far from all others and from the ground."""
    odd = np.array(sorted(values))
    if len(odd) > _MOST_ODD:
        return set()
    ground = [lowest, highest] if lowest <= highest else []
    others = np.concatenate([[-np.inf], np.sort(np.concatenate([odd, ground])), [np.inf]])
    at = np.searchsorted(others, odd)
    alone = np.minimum(odd - others[at - 1], others[at + 1] - odd) > _APART
    return set(odd[alone].tolist()) if alone.sum() <= _MOST_MARKS else set()


def _impossible(heights: Float32Array, values: set[float], resolution: float, path: Path | str) -> HeightsDoubt:
    low, high = min(values), max(values)
    said = f"{path}: heights of {low:.0f} to {high:.0f} m, ground is {LOWEST:.0f} to {HIGHEST:.0f} m"
    if low < _DEEPEST or high > HIGHEST:
        return HeightsDoubt("unit", f"{said}: convert its unit to metres, and declare its nodata value", True)
    for strip in _strips(heights):
        step = np.abs(np.diff(strip, axis=1))
        if (step[np.minimum(strip[:, 1:], strip[:, :-1]) < LOWEST] > _TOO_STEEP * resolution + _APART).any():
            text = f"{said}, with steps as beside an undeclared nodata value: declare that, and resample it again"
            return HeightsDoubt("nodata", text, True)
    return HeightsDoubt("sea", f"{said}: if that is the sea floor, give a raster of the land")


def _strips(heights: Float32Array) -> Any:
    return (heights[row : row + 256] for row in range(0, len(heights), 256))


def doubt_of_relief(heights: Float32Array, resolution: float, byte: bool, path: Path | str) -> HeightsDoubt | None:
    """Return why heights (H, W) may be in another unit, or an image (`byte`: stored in 8 bits); None if they are
    plausible. Only mountains show a unit: hills in feet are as steep as mountains in metres."""
    rows = heights[:: max(1, len(heights) // 100)]
    step = np.abs(np.diff(rows, axis=1))
    known = np.isfinite(step)
    if known.sum() < 20 * _LEAST_CELLS:
        return None
    typical, spread = float(np.median(step[known])), float(np.nanstd(rows))
    wide = float(np.nanmean(np.abs(rows[:, 4:] - rows[:, :-4]))) if rows.shape[1] > 4 else math.inf
    near = float(step[known].mean())
    # Over four cells, ground rises three times as much as over one, a hillshade up to 2.7 times.
    if byte and near > 0.15 * spread and wide < 2.9 * near:
        text = f"{path}: 8-bit values of 0 to 255 that jump from cell to cell: a hillshade or image, not elevations"
        return HeightsDoubt("image", text, True)
    slope = typical / resolution
    if resolution < _SMOOTH or slope <= _STEEP:
        return None
    text = f"{path}: half of the ground is steeper than {math.degrees(math.atan(slope)):.0f} degrees: "
    if slope > _TOO_STEEP:
        return HeightsDoubt("unit", text + "its heights are not in metres; convert them", True)
    return HeightsDoubt("steep", text + "if its heights are feet or decimetres, convert them to metres")


def doubt_of_heights(heights: Float64Array, others: Float64Array, name: str, other: str) -> HeightsDoubt | None:
    """Return why heights in metres, of the raster `name`, do not match those of `other` at the same places; None if
    they do, or if too few are known in both."""
    both = np.isfinite(heights) & np.isfinite(others)
    known = both & (np.abs(others) > 20) & (np.abs(heights) > 20)
    if known.sum() >= _LEAST_CELLS:
        ratio = float(np.median(heights[known] / others[known]))
        for unit, size in (("feet", 0.3048), ("decimetres", 0.1), ("centimetres", 0.01), ("millimetres", 0.001)):
            for code, factor, which in (("unit", 1 / size, name), ("other_unit", size, other)):
                if abs(ratio / factor - 1) < _ALIKE and _follow(heights[known], others[known]):
                    text = f"{name}: {ratio:.3g} times as high as {other}; convert {which} from {unit} to metres"
                    return HeightsDoubt(code, text, True)
    if both.sum() >= _LEAST_CELLS:
        apart = float(np.median(np.abs(heights[both] - others[both])))
        if apart > _FAR_OFF:
            text = f"{name}: {apart:.0f} m off {other} in the median; check place, unit and datum of both"
            return HeightsDoubt("shift", text)
    return None


def _follow(heights: Float64Array, others: Float64Array) -> bool:
    """Return whether heights rise and fall with others; flat ground shows neither."""
    if min(np.std(heights) / abs(np.mean(heights)), np.std(others) / abs(np.mean(others))) < 0.01:
        return True
    return bool(np.corrcoef(heights, others)[0, 1] > 0.5)


def doubt_of_surface(tops: Float64Array, ground: Float64Array, name: str) -> HeightsDoubt | None:
    """Return why a surface's heights do not go with the ground's at the same places; None if they do."""
    known = np.isfinite(tops) & np.isfinite(ground)
    if known.sum() < _LEAST_CELLS:
        return None
    tops, ground = tops[known], ground[known]
    below = float((tops < ground - 5).mean())
    if below <= 0.5:
        return doubt_of_heights(tops, ground, name, "the DEM")
    found = (
        f"{name}: {below:.0%} of the surface lies under the ground, by {np.median(ground - tops):.0f} m in the median"
    )
    if np.quantile(tops, 0.02) > -5 and np.quantile(tops, 0.98) < 120:
        text = f"{found}: these are heights above the ground (a canopy height model); add the DEM to them (gdal_calc)"
    else:
        text = f"{found}: check its place, unit and vertical datum"
    return HeightsDoubt("surface", text, True)
