"""Scenario of a fire: ignition, wind, fuel moisture and duration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.life_form import NODATA, NONBURNABLE
from ltm_core.geometry.grid import GridGeometry

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
    def parse(cls, text: str | None) -> Moisture:
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
    def parse(cls, text: str) -> Wind:
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
    from pyproj import Transformer
    from pyproj.exceptions import CRSError

    g = landscape.geometry
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(
            f"--ignition {text}: give x,y in metres of {_named(landscape)}, such as {_middle(g)}"
        ) from None
    if crs is not None:
        try:
            x, y = Transformer.from_crs(crs, g.crs, always_xy=True).transform(x, y)
        except CRSError as error:
            raise ConfigError(f"--ignition-crs {crs}: not a CRS ({error})") from error
    known = bool(np.isfinite([x, y]).all())
    row, col = (int(v) for v in g.cell_of(x, y)) if known else (-1, -1)
    if not g.contains(np.array(row), np.array(col)):
        degrees = crs is None and abs(x) <= 180 and abs(y) <= 90
        remedy = "it looks like degrees: add --ignition-crs EPSG:4326" if degrees else f"such as {_middle(g)}"
        raise ConfigError(
            f"--ignition {text}: is outside the landscape, {g.described()} in {_named(landscape)}; {remedy}"
        )
    code = int(landscape.band("fuel")[row, col])
    if code == NODATA or code in NONBURNABLE:
        what = {NODATA: "nothing is known", _WATER: "there is water"}.get(code, f"nothing burns (code {code})")
        raise ConfigError(f"--ignition {text}: {what} there; {_nearest(landscape, row, col)}")
    return row, col


def _nearest(landscape: Landscape, row: int, col: int) -> str:
    fuel = landscape.band("fuel")
    burns = ~np.isin(fuel, [NODATA, *NONBURNABLE])
    if not burns.any():
        return "nothing burns anywhere on this landscape"
    rows, cols = np.nonzero(burns)
    k = int(np.argmin((rows - row) ** 2 + (cols - col) ** 2))
    x, y = landscape.geometry.to_map(rows[k], cols[k])
    return f"the nearest cell that burns is at {float(x):.0f},{float(y):.0f}"


def _middle(g: GridGeometry) -> str:
    x_min, y_min, x_max, y_max = g.bounds
    return f"{(x_min + x_max) / 2:.0f},{(y_min + y_max) / 2:.0f}"


def _named(landscape: Landscape) -> str:
    from pyproj import CRS

    return str(CRS(landscape.geometry.crs).name)
