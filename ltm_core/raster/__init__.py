"""Read, stack and write elevation rasters."""
