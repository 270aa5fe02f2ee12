"""Pictures of depth, labels and fuel maps: arrays in, RGB arrays (H, W, 3) uint8 out; no file is touched."""

from ltm_core.pictures.legend import RangeScale, depth_colors, label_legend, range_legend, to_jpeg, to_png, with_legend
from ltm_core.pictures.maps import MapCamera
from ltm_core.pictures.photo_overlays import fit, label_colors, overlay_depth, overlay_labels, panel
from ltm_core.pictures.relief import hillshade, terrain_colors

__all__ = [
    "MapCamera",
    "RangeScale",
    "depth_colors",
    "fit",
    "hillshade",
    "label_colors",
    "label_legend",
    "overlay_depth",
    "overlay_labels",
    "panel",
    "range_legend",
    "terrain_colors",
    "to_jpeg",
    "to_png",
    "with_legend",
]
