"""Prepare what poses of a site's cameras are compared with, and what a corrected pose depends on."""

from __future__ import annotations

import hashlib
import json

from ltm_core.base.errors import StoreError
from ltm_core.geometry.camera import Camera
from ltm_core.pose_estimation.skyline.crest_cover import CANOPY_SURFACE
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig, SkylineConfig
from ltm_core.site.site import Site


def mount_terms(site: Site, camera: str, seen: Camera | None) -> str:
    """Hexadecimal SHA-256 of all that a correction of a camera's poses hangs on. `seen`: the calibration of its
    pictures; None where the site states it. Raises StoreError for a raster that is not there."""
    stated = site.camera(camera).model_dump(mode="json", include={"pose", "mount", "sensors", "calibration"})
    rasters = [site.dem, *site.coarser, *([] if site.surface is None else [site.surface])]
    try:
        files = [(raster.path.name, (at := raster.path.stat()).st_size, at.st_mtime_ns) for raster in rasters]
    except OSError as error:
        raise StoreError(f"{error.filename}: {error.strerror}; mend `dem` in the site file") from error
    ground = [files, site.crs, site.origin, site.bend, site.possible_ground.model_dump(mode="json")]
    lens = None if seen is None else [seen.width, seen.height, seen.fx, seen.fy, seen.cx, seen.cy, *seen.distortion]
    return hashlib.sha256(json.dumps([stated, ground, lens], sort_keys=True).encode()).hexdigest()


def site_terrain(site: Site) -> tuple[SearchTerrain, PicturePoseConfig]:
    """The site's ground, with the tops of trees where it has a surface raster, and the constants that fit it.

    Raises DemError as `Site.open_dem`.
    """
    bare = site.open_dem()
    ground = site.open_surface(bare)
    config = PicturePoseConfig()
    if ground is not bare:
        config = PicturePoseConfig(skyline=SkylineConfig(cover=CANOPY_SURFACE))
    return SearchTerrain(ground, site.bend, site.possible_ground), config
