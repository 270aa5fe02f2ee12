"""Writes the files of `ltm viewshed`: coverage as GeoTIFF and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.visibility.viewshed import Coverage, PosedCamera

BANDS = (
    "cameras that see the cell",
    "best footprint of a pixel, longer side, m",
    "height above ground that becomes visible, m",
)


@dataclass(frozen=True)
class _Counts:
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


_PALETTE = _Counts(
    ("not seen", "1 camera", "2 cameras", "3 cameras", "4 or more"),
    ((92, 98, 112), (253, 190, 92), (243, 130, 62), (214, 68, 66), (140, 32, 92)),
)


def write_coverage(path: Path | str, coverage: Coverage, frame: SiteFrame) -> None:
    """Write the three bands of BANDS as float32 in the frame's CRS, NaN where there is no value."""
    import rasterio

    count = np.where(coverage.count < 0, np.nan, coverage.count).astype(np.float32)
    geometry = coverage.geometry.translated(frame.x_origin, frame.y_origin, crs=frame.crs)
    write_geotiff(path, np.stack([count, coverage.footprint, coverage.height]), geometry, nodata=float("nan"))
    with rasterio.open(path, "r+") as sink:
        sink.descriptions = BANDS


def coverage_picture(
    coverage: Coverage, dem: Dem, views: Sequence[PosedCamera], title: str | None = None
) -> UInt8Array:
    """The number of cameras that see each cell over shaded relief, RGB (H, W, 3), with the cameras and a legend.

    `dem`: in the frame of the coverage.
    """
    from ltm_core.pictures import MapCamera, fuel_map_picture

    classes = np.clip(coverage.count, 0, len(_PALETTE.names) - 1).astype(np.uint8)
    classes[coverage.count < 0] = 255
    reach = 0.08 * max(
        coverage.geometry.x_max - coverage.geometry.x_min, coverage.geometry.y_max - coverage.geometry.y_min
    )
    cameras = [
        MapCamera(
            view.name,
            view.camera,
            (float(view.pose.position[0]), float(view.pose.position[1])),
            view.pose.angles_deg[0],
            reach,
        )
        for view in views
    ]
    return fuel_map_picture(classes, coverage.geometry, _PALETTE, dem, cameras, coverage.geometry.bounds, title=title)
