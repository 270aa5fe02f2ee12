"""The small site as it would stand: frames of today, a prior map, fused depth, a living terrain, all of it kept."""

from pathlib import Path

import numpy as np
import yaml
from scenes.small_site import SmallSite
from scenes.terrain_frames import write_fusing_site

from ltm_core.raster.raster_io import write_geotiff

PRIOR_CODE = 183
"""Of every cell: timber litter, so that grass and houses contradict it."""
SILENT_S = 5.0
"""After which a node without a sign of life is given up, so that its camera is back in time."""
NO_CHANGE = 1000.0
"""Metres by which the surface would have to move: what becomes of the fuel map then is for other tests, and here the
map shall follow from the votes alone."""


def write_living_site(folder: Path, processes: str = "site") -> SmallSite:
    """In an empty folder. Its cameras' frames must bear the stamps of the machine's clock, as in the field.
    `processes`: as in a site file."""
    small = write_fusing_site(folder, recording=False)
    grid = small.site.in_crs(small.site.fuel_geometry(small.dem))
    write_geotiff(folder / "prior.tif", np.full(grid.shape, PRIOR_CODE, np.int16), grid, -9999)
    content = yaml.safe_load(small.path.read_text())
    del content["nodes"]
    content["fuel"] = {"prior": "prior.tif"}
    content["expert"]["processes"] = processes
    content["expert"]["terrain"]["threshold"] = NO_CHANGE
    content["expert"]["watchdog"] = {"silent": SILENT_S}
    small.path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return SmallSite(folder)
