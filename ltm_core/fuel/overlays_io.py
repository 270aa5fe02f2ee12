"""Read vector layers onto the fuel grid: barriers, and burned areas with their dates."""

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pyproj import Transformer

from ltm_core.base.errors import ConfigError
from ltm_core.base.number_text import counted, stamp_of_moment
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float32Array, Int16Array, Int64Array
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.config_io import read_text

_STRIP: Final = 256
_FINE: Final = 8
"""Number of parts per side of a cell, used to compute the share that an area covers."""


class BarrierConfig(StrictModel):
    """GeoJSON file (longitude and latitude, WGS 84) that does not burn: areas take cells that they cover by half, lines
    all cells that they cross, so that no fire passes between two of them."""

    path: Path
    """Path of the GeoJSON file, relative to the site file."""
    kind: Literal["built", "road", "water"]
    """Kind of barrier: water gets the code NB8 (98), others NB1 (91)."""


def barrier_codes(barriers: Iterable[BarrierConfig], geometry: GridGeometry) -> Int16Array:
    """Return (H, W) NB1 and NB8 where the layers have barriers, NODATA elsewhere. Raises ConfigError for an unreadable
    file."""
    from rasterio.features import rasterize

    codes = np.full(geometry.shape, NODATA, np.int16)
    for barrier in barriers:
        lines, areas = _shapes(barrier, geometry)
        taken = covered_share(areas, geometry) >= LEAST_SHARE
        if lines:
            taken |= rasterize(lines, geometry.shape, transform=geometry.transform(), all_touched=True).astype(bool)
        codes[taken] = 98 if barrier.kind == "water" else 91
    return codes


def covered_share(areas: Sequence[Any], geometry: GridGeometry) -> Float32Array:
    """Return (H, W) the share of each cell that areas cover, 0 to 1; GeoJSON geometries in the grid's CRS."""
    from rasterio.features import rasterize
    from rasterio.transform import from_origin

    share = np.zeros(geometry.shape, np.float32)
    # In strips of rows: of a large site the fine grid would take gigabytes.
    for top in range(0, geometry.height, _STRIP) if areas else ():
        strip = geometry.window(top, 0, min(_STRIP, geometry.height - top), geometry.width)
        fine = from_origin(strip.x_min, strip.y_max, strip.resolution / _FINE, strip.resolution / _FINE)
        covered = rasterize(areas, (strip.height * _FINE, strip.width * _FINE), transform=fine)
        share[top : top + strip.height] = covered.reshape(strip.height, _FINE, strip.width, _FINE).mean(axis=(1, 3))
    return share


def _shapes(barrier: BarrierConfig, geometry: GridGeometry) -> tuple[list[Any], list[Any]]:
    """Return the lines and areas that come near the grid, in its CRS, as GeoJSON geometries. Raises ConfigError."""
    turn = Transformer.from_crs("OGC:CRS84", geometry.crs, always_xy=True)
    lines, areas = list[Any](), list[Any]()
    for place, feature in _features(barrier.path):
        with _geometry(place):
            shape = feature["geometry"] or {"type": "GeometryCollection", "geometries": []}
            for part in shape["geometries"] if shape["type"] == "GeometryCollection" else [shape]:
                if part["type"] in ("LineString", "MultiLineString"):
                    several = [part["coordinates"]] if part["type"] == "LineString" else part["coordinates"]
                    lines += [{"type": "LineString", "coordinates": _turned(line, turn, place, 2)} for line in several]
                elif part["type"] not in ("Point", "MultiPoint"):
                    areas += _areas(part, turn, place)
    found = [s for s in lines if near([s["coordinates"]], geometry)]
    return found, [a for a in areas if near(a["coordinates"], geometry)]


def near(rings: Any, geometry: GridGeometry) -> bool:
    """Return whether a shape's box meets the grid and can be converted to the grid's CRS."""
    points = np.concatenate([np.asarray(ring, np.float64) for ring in rings])
    if not np.isfinite(points).all():
        return False
    x_min, y_min, x_max, y_max = geometry.bounds
    (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
    return bool(left <= x_max and right >= x_min and low <= y_max and high >= y_min)


BURNED_AT: Final = "burned_at"
"""Property of a feature with the time of the burn: ISO 8601, UTC unless it has a zone."""
LEAST_SHARE: Final = 0.5
"""Minimum share of a cell for it to count as burned, or as a barrier."""
_LARGEST: Final = 64 << 20
_LATEST_NS = stamp_of_moment(datetime(2106, 1, 1))
"""Latest time that fits a cell's state (`EvidenceMap.burn`)."""


@dataclass(frozen=True, eq=False)
class Burn:
    """Burned cells of one time. `cells`: (N,) numbers of cells of a fuel grid, row by row, increasing."""

    stamp_ns: int
    cells: Int64Array

    def mask(self, shape: tuple[int, int]) -> BoolArray:
        """Return (H, W), True for burned cells."""
        found = np.zeros(shape, np.bool_)
        found.flat[self.cells] = True
        return found


def read_burns(path: Path, geometry: GridGeometry) -> list[Burn]:
    """Read the burns of a GeoJSON file (RFC 7946: longitude and latitude, WGS 84) on the fuel grid `geometry`, in the
    site's CRS, by time; areas of one time are one burn, areas outside the grid are ignored. Polygons and multipolygons
    with the property `burned_at`. Raises ConfigError for a file that is none of such."""
    turn = Transformer.from_crs("OGC:CRS84", geometry.crs, always_xy=True)
    areas: dict[int, list[Any]] = {}
    for place, feature in _features(path):
        with _geometry(place):
            stamp = _stamp_ns((feature.get("properties") or {}).get(BURNED_AT), place)
            areas.setdefault(stamp, []).extend(_areas(feature["geometry"], turn, place))
    burns = []
    for stamp, found in sorted(areas.items()):
        here = [area for area in found if near(area["coordinates"], geometry)]
        burns.append(Burn(stamp, np.flatnonzero(covered_share(here, geometry) >= LEAST_SHARE)))
    return [burn for burn in burns if len(burn.cells)]


def _features(path: Path) -> list[tuple[str, Any]]:
    """Return the features of a GeoJSON file with their places, for errors. Raises ConfigError."""
    try:
        content = json.loads(read_text(path, _LARGEST, ConfigError))
        features = [content] if content["type"] == "Feature" else list(content["features"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read as GeoJSON ({error}); give a FeatureCollection") from error
    return [(f"{path}, feature {number}", feature) for number, feature in enumerate(features)]


@contextmanager
def _geometry(place: str) -> Iterator[None]:
    """Raise ConfigError for a feature without a valid geometry."""
    try:
        yield
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise ConfigError(f"{place}: not a valid geometry ({type(error).__name__}: {error})") from error


def _areas(shape: Any, turn: Transformer, place: str) -> list[dict[str, Any]]:
    kinds = {"Polygon": lambda found: [found], "MultiPolygon": list}
    if shape["type"] not in kinds:
        raise ConfigError(f"{place}: is a {shape['type']}; an area must be a Polygon or MultiPolygon")
    found = []
    for rings in kinds[shape["type"]](shape["coordinates"]):
        turned = [_turned(ring, turn, place, 4) for ring in rings]
        if not turned:
            raise ConfigError(f"{place}: a polygon without a ring")
        found.append({"type": "Polygon", "coordinates": turned})
    return found


def _turned(coordinates: Any, turn: Transformer, place: str, least: int) -> list[tuple[float, float]]:
    """Return the points of a line or ring of at least `least` points in the grid's CRS."""
    points = np.asarray([point[:2] for point in coordinates], np.float64)
    if len(points) < least:
        raise ConfigError(f"{place}: {counted(len(points), 'point')}; a line has two or more, a closed ring four")
    if not (np.abs(points) <= (180.0, 90.0)).all():  # neither is NaN
        raise ConfigError(f"{place}: points must be [longitude, latitude] in degrees")
    x, y = turn.transform(points[:, 0], points[:, 1])
    return list(zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True))


def _stamp_ns(text: Any, place: str) -> int:
    try:
        moment = datetime.fromisoformat(text)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{place}: its property {BURNED_AT} is {text!r}; write when it burned, as 2026-08-01T14:00:00Z"
        ) from error
    stamp_ns = stamp_of_moment(moment)
    if not 0 <= stamp_ns < _LATEST_NS:
        raise ConfigError(f"{place}: burned at {text}, outside 1970 to 2105")
    return stamp_ns
