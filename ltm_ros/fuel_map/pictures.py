"""Draw images of a site's fuel map, for exports and reports: layers, cameras, window and past states."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from ltm_core.base.errors import ConfigError, PoseError, RasterError
from ltm_core.base.types import BoolArray, Float32Array
from ltm_core.fuel.class_map import CoverageMap
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.fuel_maps import CameraMark, FuelCanvas
from ltm_core.pipeline.stored_fuel import JOURNALED
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.storage.tile_store import TileStore


def places_of(site: Site, dem: Dem) -> list[CameraMark]:
    """Return the cameras with positions in the site file, in the map frame."""
    found = []
    for name, camera in site.cameras.items():
        if camera.pose is not None:
            try:
                x, y, _ = camera.pose.pose(dem, site.frame).position
            except PoseError:
                continue
            found.append(CameraMark(name, float(x), float(y)))
    return found


def canvas_of(
    site: Site,
    dem: Dem,
    geometry: GridGeometry,
    places: Sequence[CameraMark] | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    width: int = 760,
) -> FuelCanvas:
    """Return a canvas for layers on `geometry`, a fuel grid in the map frame, over the site's `dem`; axes in the site's
    CRS.
    """
    shown = places_of(site, dem) if places is None else places
    return FuelCanvas(geometry, Dem(dem.elevation, dem.geometry), shown, bounds, site.origin, width)


def when(text: str) -> int:
    """Parse a date (its end) or an ISO 8601 time, UTC by default, to nanoseconds. Raises ConfigError."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise ConfigError(f"{text!r} is not a date; give 2026-05-31 or 2026-05-31T12:00:00Z") from error
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    end = 86400 if len(text) == len("2026-05-31") else 1
    return (int(moment.timestamp()) + end) * 10**9 - 1


def layers_as_of(store: TileStore, empty: FuelLayers, until_ns: int) -> FuelLayers:
    """Return codes and life forms of the map as of a past time; confidences of past times are not stored.

    `empty`: the layers without any evidence.
    """
    found = {name: store.as_of(name, getattr(empty, name), until_ns) for name in JOURNALED}
    unknown: Float32Array = np.full(empty.code.shape, np.nan, np.float32)
    return replace(empty, **found, changed=found["code"] != empty.prior, p_max=unknown, entropy=unknown.copy())


def seen_window(
    geometry: GridGeometry, cells: BoolArray, places: Sequence[CameraMark]
) -> tuple[float, float, float, float]:
    """Return the bounds of the marked cells (H, W) and the cameras, with a margin of five cells; of all cells if none
    is marked.

    Raises RasterError if shapes differ.
    """
    if cells.shape != geometry.shape:
        raise RasterError(f"cells of {cells.shape} do not fit a fuel grid of {geometry.shape}")
    rows, cols = np.nonzero(cells)
    x, y = geometry.to_map(rows, cols)
    xs, ys = [*x.tolist(), *(p.x for p in places)], [*y.tolist(), *(p.y for p in places)]
    if not xs:
        return geometry.bounds
    margin = 5 * geometry.resolution
    west, east = max(min(xs) - margin, geometry.x_min), min(max(xs) + margin, geometry.x_max)
    south, north = max(min(ys) - margin, geometry.y_min), min(max(ys) + margin, geometry.y_max)
    return west, south, east, north


def coverage_of(votes: Iterable[CellVotes], geometry: GridGeometry) -> CoverageMap:
    """Return how often and how finely each camera has seen each cell of a fuel grid, in the map frame."""
    coverage = CoverageMap(geometry)
    for one in votes:
        coverage.add(one)
    return coverage
