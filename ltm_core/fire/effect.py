"""Describe a fire, compare it on the previous and the updated map, and read and write its rasters."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.types import BoolArray, Float32Array
from ltm_core.fuel.band_values_io import in_landfire_units, read_quantity
from ltm_core.fuel.codes import system_of_codes
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, Landscape
from ltm_core.fuel.export.landscape_io import write_raster
from ltm_core.fuel.fuel_bands_io import CODES, POSITIONS, file_bands
from ltm_core.fuel.life_form import NODATA, NONBURNABLE
from ltm_core.geometry.geodesy import MOST_EXPORTED, map_problem, read_crs, same_crs, scale_problem
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import open_raster

USUAL_HOURS = (1.0, 3.0, 6.0)


@dataclass(frozen=True)
class Area:
    """Burned area in hectares some hours after ignition."""

    hours: float
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class FireRun:
    """Result of a fire, (H, W) each. `arrival`: hours after ignition, NaN where the fire does not arrive. `flame`:
    length in metres, 0 where it does not arrive."""

    arrival: Float32Array
    flame: Float32Array

    @property
    def burned(self) -> BoolArray:
        return np.isfinite(self.arrival)

    def reaches_edge(self) -> float | None:
        """Return the hours until the fire reaches the landscape's edge; None: never."""
        inner = np.full_like(self.arrival, np.nan)
        inner[1:-1, 1:-1] = 0
        return _first(self.arrival[np.isnan(inner)])


@dataclass(frozen=True, eq=False)
class FireEffect:
    """Comparison of two fires. `changed`: (H, W) cells with different fuel or canopy."""

    before: FireRun
    after: FireRun
    changed: BoolArray
    cell: float
    hours: float

    def difference(self) -> Float32Array:
        """Return (H, W) hours by which the fire arrives later on the updated map; NaN unless it arrives on both."""
        return self.after.arrival - self.before.arrival

    def flame_difference(self) -> Float32Array:
        """Return (H, W) metres by which flames are longer on the updated map; NaN unless the fire arrives on both."""
        both = self.before.burned & self.after.burned
        return np.where(both, self.after.flame - self.before.flame, np.float32(np.nan))

    def areas(self) -> list[Area]:
        hectares, runs = self.cell**2 / 1e4, (self.before, self.after)
        hours = sorted({h for h in USUAL_HOURS if h < self.hours} | {self.hours})
        return [Area(h, *(float((run.arrival <= h).sum() * hectares) for run in runs)) for h in hours]

    def first_contact(self) -> float | None:
        """Return hours until a fire, on the previous or the updated map, reaches a changed cell; None: never. Cells
        that no longer burn count by the previous map."""
        return _first(np.concatenate([run.arrival[self.changed] for run in (self.before, self.after)]))


def _first(arrivals: Float32Array) -> float | None:
    known = arrivals[np.isfinite(arrivals)]
    return float(known.min()) if known.size else None


def changed_fuel(before: Landscape, after: Landscape) -> BoolArray:
    """Return (H, W) cells with a different fuel model or canopy band, of landscapes on one grid."""
    return np.asarray((before.bands[3:] != after.bands[3:]).any(axis=0))


def read_landscape(path: Path) -> Landscape:
    """Read a landscape. Raises RasterError for a file without the eight bands, a metric CRS or square cells."""
    with open_raster(path) as source:
        found = sorted(file_bands(source, path), key=lambda band: band.quantity == "fbfm40")  # before FBFM13
        bands = {"codes" if band.quantity in CODES else band.quantity: band for band in found}
        missing = [name for name in POSITIONS if name not in bands]
        if missing:
            raise RasterError(
                f"{path}: has no {', '.join(missing)}; a fire needs a landscape of {len(LANDSCAPE_BANDS)} bands: write "
                "one with `ltm export --format landscape` or `--format lcp`"
            )
        if bands["aspect"].unit:
            raise RasterError(f"{path}: its aspects are {bands['aspect'].unit}; write it again with azimuths")
        t = source.transform
        if t.b or t.d or t.a <= 0 or abs(t.a + t.e) > 1e-6 * t.a:
            raise RasterError(f"{path}: a landscape is north-up with square cells, this has {tuple(t)[:6]}")
        if source.crs is None or not source.crs.is_projected:
            raise RasterError(
                f"{path}: the CRS is {source.crs or 'missing'}; a fire needs a projected CRS in metres: export it "
                "again with `ltm export --crs EPSG:...`, and keep the .prj beside an LCP"
            )
        geometry = GridGeometry(t.c, t.f, t.a, source.width, source.height, source.crs.to_wkt())
        problem = map_problem(read_crs(source.crs)) or scale_problem(source.crs, geometry, MOST_EXPORTED)
        if problem is not None:
            raise RasterError(f"{path}: {problem}")
    read, _ = in_landfire_units((band, read_quantity(band)) for band in bands.values())
    codes = read.pop(bands["codes"].quantity)
    stack = np.stack([codes if name == "codes" else read[name] for name in POSITIONS])
    return Landscape(stack, geometry, system_of_codes(codes))


def require_same_grid(before: Landscape, after: Landscape, names: tuple[str, str]) -> None:
    """Raise ConfigError unless both are on one grid."""
    a, b = before.geometry, after.geometry
    if not same_crs(a.crs, b.crs):
        raise ConfigError(
            f"{names[0]} is in {read_crs(a.crs).name}, {names[1]} in {read_crs(b.crs).name}: cells cannot be compared; "
            "export both into one CRS with `ltm export --crs`"
        )
    same = (a.x_min, a.y_max, a.resolution, a.shape) == (b.x_min, b.y_max, b.resolution, b.shape)
    if not same:
        raise ConfigError(
            f"{names[0]} has {a.described()}, {names[1]} {b.described()}: export both of the same site, so that they "
            "have one grid"
        )


BANDS: Mapping[str, str] = {
    "arrival_before": "hours after ignition",
    "arrival_after": "hours after ignition",
    "arrival_difference": "hours, positive: later on the updated map",
    "flame_before": "m",
    "flame_after": "m",
    "flame_difference": "m, positive: longer on the updated map",
    "changed": "fuel or canopy changed: 0 no, 1 yes",
}
"""Name and unit of each band."""


def write_fire(path: Path, effect: FireEffect, geometry: GridGeometry, tags: Mapping[str, str]) -> None:
    """Write one GeoTIFF of float32 bands, NaN where the fire does not arrive. Raises ConfigError if it cannot be
    written."""
    runs = effect.before, effect.after
    arrivals, flames = [run.arrival for run in runs], [np.where(run.burned, run.flame, np.nan) for run in runs]
    layers = *arrivals, effect.difference(), *flames, effect.flame_difference(), effect.changed
    array = np.stack([np.asarray(layer, np.float32) for layer in layers])
    write_raster(path, array, geometry, float("nan"), tuple(BANDS), tuple(BANDS.values()), tags=tags)


_DEAD: Final = {"D1": (3.0, 4.0, 5.0), "D2": (6.0, 7.0, 8.0), "D3": (9.0, 10.0, 11.0), "D4": (12.0, 13.0, 14.0)}
_LIVE: Final = {"L1": (30.0, 60.0), "L2": (60.0, 90.0), "L3": (90.0, 120.0), "L4": (120.0, 150.0)}
"""Live fuel moistures of Scott and Burgan (2005), tables 5 and 6: very low, low, moderate, high; fully, two thirds and
one third cured, green."""
MOISTURE_HELP: Final = (
    "a scenario of Scott and Burgan such as D2L2 (dead D1 very low to D4 high, live L1 cured to L4 green), or five "
    "percentages: dead 1 h, 10 h, 100 h, live herbaceous, live woody, such as 6,7,8,60,90"
)
_MOST_HOURS: Final = 72.0
_WATER: Final = 98


@dataclass(frozen=True)
class Moisture:
    """Fuel moisture in % of the dry weight: dead fuel of 1 h, 10 h and 100 h, live herbs, live wood, crown needles."""

    dead_1h: float
    dead_10h: float
    dead_100h: float
    live_herbaceous: float
    live_woody: float
    foliar: float = 100.0

    @classmethod
    def parse(cls, text: str | None) -> "Moisture":
        """Parse a moisture. Raises ConfigError unless it is a scenario or five percentages."""
        if not text:
            raise ConfigError(f"a fire needs the fuel moisture: give --moisture, {MOISTURE_HELP}")
        name = text.strip().upper()
        if len(name) == 4 and name[:2] in _DEAD and name[2:] in _LIVE:
            return cls(*_DEAD[name[:2]], *_LIVE[name[2:]])
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if len(values) != 5 or not all(0 < v <= 400 for v in values):
            raise ConfigError(f"--moisture {text}: invalid; give {MOISTURE_HELP}")
        return cls(*values)

    def described(self) -> str:
        return (
            f"dead {self.dead_1h:g}, {self.dead_10h:g}, {self.dead_100h:g} %, live {self.live_herbaceous:g}, "
            f"{self.live_woody:g} %, needles {self.foliar:g} %"
        )


@dataclass(frozen=True)
class Wind:
    """Wind. `speed`: m/s at 10 m above ground or open canopy. `direction`: degrees clockwise from grid north from which
    it blows."""

    speed: float
    direction: float

    @classmethod
    def parse(cls, text: str) -> "Wind":
        """Parse a wind. Raises ConfigError unless it is a speed and a direction."""
        try:
            speed, direction = (float(part) for part in text.split(","))
        except ValueError:
            raise ConfigError(
                f"--wind {text}: give the speed at 10 m in m/s and the direction it blows from, degrees clockwise "
                "from north, such as 8,45"
            ) from None
        if not 0 <= speed <= 60 or not 0 <= direction <= 360:
            raise ConfigError(f"--wind {text}: speeds are 0 to 60 m/s, directions 0 to 360 degrees")
        return cls(speed, direction % 360)

    def described(self) -> str:
        return f"{self.speed:g} m/s at 10 m, from {self.direction:g} degrees"


@dataclass(frozen=True)
class FireScenario:
    """Fire under constant wind. `row`, `col`: the ignition cell. `hours`: its duration."""

    row: int
    col: int
    wind: Wind
    moisture: Moisture
    hours: float

    def __post_init__(self) -> None:
        if not 0 < self.hours <= _MOST_HOURS:
            raise ConfigError(f"--hours {self.hours:g}: give at most {_MOST_HOURS:g} hours for a constant wind")


def ignition_cell(text: str, crs: str | None, landscape: Landscape) -> tuple[int, int]:
    """Return row and column of "x,y" in `crs`, by default the landscape's own. Raises ConfigError for an invalid place,
    one outside, and one where nothing burns."""
    from pyproj import CRS, Transformer
    from pyproj.exceptions import CRSError

    g = landscape.geometry
    x_min, y_min, x_max, y_max = g.bounds
    named, middle = CRS(g.crs).name, f"such as {(x_min + x_max) / 2:.0f},{(y_min + y_max) / 2:.0f}"
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"--ignition {text}: give x,y in metres of {named}, {middle}") from None
    if crs is not None:
        try:
            x, y = Transformer.from_crs(crs, g.crs, always_xy=True).transform(x, y)
        except CRSError as error:
            raise ConfigError(f"--ignition-crs {crs}: not a CRS ({error})") from error
    row, col = (int(v) for v in g.cell_of(x, y)) if np.isfinite([x, y]).all() else (-1, -1)
    if not g.contains(np.array(row), np.array(col)):
        degrees = crs is None and abs(x) <= 180 and abs(y) <= 90
        remedy = "it looks like degrees: add --ignition-crs EPSG:4326" if degrees else middle
        raise ConfigError(f"--ignition {text}: is outside the landscape, {g.described()} in {named}; {remedy}")
    fuel = landscape.band("fuel")
    burns, code = ~np.isin(fuel, [NODATA, *NONBURNABLE]), int(fuel[row, col])
    if not burns[row, col]:
        what = {NODATA: "nothing is known", _WATER: "there is water"}.get(code, f"nothing burns (code {code})")
        near = "nothing burns anywhere on this landscape"
        if burns.any():
            rows, cols = np.nonzero(burns)
            k = int(np.argmin((rows - row) ** 2 + (cols - col) ** 2))
            east, north = (float(v) for v in g.to_map(rows[k], cols[k]))
            near = f"the nearest cell that burns is at {east:.0f},{north:.0f}"
        raise ConfigError(f"--ignition {text}: {what} there; {near}")
    return row, col
