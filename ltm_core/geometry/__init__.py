"""Grids, cameras, poses, lenses and coordinates."""
