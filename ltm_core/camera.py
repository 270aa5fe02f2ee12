"""Cameras: `from ltm_core.camera import Camera`."""

from ltm_core.geometry.camera import Camera

__all__ = ["Camera"]
