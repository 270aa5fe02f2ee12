"""Raster geometry: `from ltm_core.grid import GridGeometry`."""

from ltm_core.geometry.grid import GridGeometry

__all__ = ["GridGeometry"]
