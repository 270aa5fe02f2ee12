"""Estimate camera poses from images: control points, skylines and mounts."""
