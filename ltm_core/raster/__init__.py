"""Reads, stacks and writes elevation rasters, and stores maps as tiles in one file."""
