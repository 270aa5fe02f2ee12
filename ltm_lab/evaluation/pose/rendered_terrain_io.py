"""The ground that a rendered site gives to the search of its pictures' poses."""

from __future__ import annotations

from pathlib import Path

from ltm_core.base.errors import RecordingError
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack, with_surface
from ltm_core.tracing.holes import NOTHING_BEYOND, PossibleGround
from ltm_lab.evaluation.truth_frames_io import dates, is_curved, open_dem, site_frame


def rendered_terrain(folder: Path, alone: bool, canopy: bool) -> SearchTerrain:
    """The site's DEM within those of the range around and of the region to the horizon, at whose end the world ends;
    `alone`: without them, and nothing is known of what lies beyond. `canopy`: with the true surface raster of the first
    date. Raises RecordingError where a folder of `ltm-lab simulate` has none of these.
    """
    frame = site_frame(folder)
    dem = open_dem(folder)
    if not alone:
        levels = [dem]
        for name in ("dem_around.tif", "dem_region.tif"):
            if not (folder / name).is_file():
                raise RecordingError(
                    f"{folder / name} is missing: `ltm-lab simulate SCENARIO --out {folder} --site-only` writes it"
                )
            levels.append(Dem.open(folder / name).in_frame(frame))
        dem = DemStack(levels)
    if canopy:
        named = dates(folder)
        surface = folder / "truth" / (named[0] if named else "now") / "surface.tif"
        dem = with_surface(dem, Dem.open(surface).in_frame(frame))
    return SearchTerrain(dem, ray_bend(is_curved(folder), 0.13), PossibleGround() if alone else NOTHING_BEYOND)
