"""Elevation rasters read, stacked and written, and the tiled store in which maps keep their state."""
