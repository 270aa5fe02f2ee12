"""Names of the networks that are taken where none is named: manifests in config/models, which ship with the system."""

from typing import Final

DEFAULT_MODEL: Final = "landscape_v2"
"""Of labels,"""
DEFAULT_DEPTH_MODEL: Final = "landscape_v2_depth"
"""and of depth: the same file's other output."""
