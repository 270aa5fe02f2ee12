"""Files of `ltm locate`: masks of pictures, the posterior as a GeoTIFF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ltm_core.camera import Camera
from ltm_core.errors import RegionError
from ltm_core.geodesy import SiteFrame
from ltm_core.locating.posterior import Posterior
from ltm_core.types import BoolArray


def read_mask(path: Path, camera: Camera) -> BoolArray:
    """A picture of the camera's size whose pixels that are not black are masked, (H, W).

    Raises ImageError for a file that is no picture, RegionError for one of another size.
    """
    from ltm_core.picture_io import open_picture

    with open_picture(path) as (source, _):
        mask = np.asarray(source.convert("L")) > 0
    if mask.shape != (camera.height, camera.width):
        raise RegionError(
            f"{path}: a mask of {mask.shape[1]} x {mask.shape[0]} pixels, the camera's pictures have "
            f"{camera.width} x {camera.height}"
        )
    return mask


def write_posterior(path: Path, posterior: Posterior, frame: SiteFrame) -> None:
    """Probability a cell, float32, in the frame's CRS; 0 where there is none."""
    from ltm_core.raster.raster_io import write_geotiff

    geometry = posterior.geometry.translated(frame.x_origin, frame.y_origin, crs=frame.crs)
    write_geotiff(path, posterior.raster().astype(np.float32), geometry, nodata=0.0)
