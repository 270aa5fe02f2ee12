"""Reads where and when land has burned, from GeoJSON, onto a fuel grid."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import Transformer

from ltm_core.errors import ConfigError
from ltm_core.fuel.barriers_io import covered_share, near
from ltm_core.grid import GridGeometry
from ltm_core.text_io import read_text
from ltm_core.types import BoolArray, Int64Array
from ltm_core.utc_time import stamp_of_moment

BURNED_AT: Final = "burned_at"
"""Property of a feature: when its area burned, ISO 8601, UTC unless it names a zone."""
LEAST_SHARE: Final = 0.5
"""Of a cell that must have burned, for it to have burned."""
_LARGEST: Final = 64 << 20
_LATEST_NS = stamp_of_moment(datetime(2106, 1, 1))
"""What fits into a cell's state (`EvidenceMap.burn`)."""


@dataclass(frozen=True, eq=False)
class Burn:
    """`cells`: (N,) numbers of the burned cells of a fuel grid, row by row, rising."""

    stamp_ns: int
    cells: Int64Array

    def mask(self, shape: tuple[int, int]) -> BoolArray:
        """(H, W), true where it burned."""
        found = np.zeros(shape, np.bool_)
        found.flat[self.cells] = True
        return found


def read_burns(path: Path, geometry: GridGeometry) -> list[Burn]:
    """The burns of a GeoJSON file (RFC 7946: longitude and latitude, WGS 84) on the fuel grid `geometry`, in the site's
    CRS, by their times; areas of one time are one burn, those beside the grid none.

    Polygons and multipolygons with the property `burned_at`. Raises ConfigError for a file that is none of such.
    """
    try:
        content = json.loads(read_text(path, _LARGEST, ConfigError))
        features = [content] if content["type"] == "Feature" else list(content["features"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read as GeoJSON ({error}); give a FeatureCollection of areas") from error
    turn = Transformer.from_crs("OGC:CRS84", geometry.crs, always_xy=True)
    areas: dict[int, list[Any]] = {}
    for number, feature in enumerate(features):
        place = f"{path}, feature {number}"
        try:
            stamp = _stamp_ns((feature.get("properties") or {}).get(BURNED_AT), place)
            areas.setdefault(stamp, []).extend(_areas(feature["geometry"], turn, place))
        except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise ConfigError(f"{place}: is no area ({type(error).__name__}: {error})") from error
    burns = (_burn(stamp, areas[stamp], geometry) for stamp in sorted(areas))
    return [burn for burn in burns if len(burn.cells)]


def _burn(stamp_ns: int, areas: Iterable[Any], geometry: GridGeometry) -> Burn:
    here = [area for area in areas if near(area["coordinates"], geometry)]
    return Burn(stamp_ns, np.flatnonzero(covered_share(here, geometry) >= LEAST_SHARE))


def _areas(shape: Any, turn: Transformer, place: str) -> list[dict[str, Any]]:
    kinds = {"Polygon": lambda found: [found], "MultiPolygon": list}
    if shape["type"] not in kinds:
        raise ConfigError(f"{place}: is a {shape['type']}; what burned is a Polygon or MultiPolygon")
    found = []
    for rings in kinds[shape["type"]](shape["coordinates"]):
        turned = []
        for ring in rings:
            points = np.asarray([point[:2] for point in ring], np.float64)
            if len(points) < 4:
                raise ConfigError(f"{place}: a ring of {len(points)} points; it needs four, the last as the first")
            if not (np.abs(points) <= (180.0, 90.0)).all():  # neither is NaN
                raise ConfigError(f"{place}: points are longitude and latitude, in this order, degrees")
            x, y = turn.transform(points[:, 0], points[:, 1])
            turned.append(list(zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True)))
        if not turned:
            raise ConfigError(f"{place}: a polygon without a ring")
        found.append({"type": "Polygon", "coordinates": turned})
    return found


def _stamp_ns(text: Any, place: str) -> int:
    try:
        moment = datetime.fromisoformat(text)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{place}: its property {BURNED_AT} is {text!r}; write when it burned, as 2026-08-01T14:00:00Z"
        ) from error
    stamp_ns = stamp_of_moment(moment)
    if not 0 <= stamp_ns < _LATEST_NS:
        raise ConfigError(f"{place}: burned at {text}, which is not in 1970 to 2105")
    return stamp_ns
