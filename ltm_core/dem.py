"""Elevation rasters: `from ltm_core.dem import Dem`."""

from ltm_core.raster.dem import Dem

__all__ = ["Dem"]
