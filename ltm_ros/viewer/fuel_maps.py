"""Convert core types for Rerun, and draw the changes of the terrain."""

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ltm_core.base.types import Float32Array, RgbImage, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures import RangeScale, depth_colors, label_legend, range_legend, to_jpeg, to_png, with_legend
from ltm_core.pictures.legend import INK, PAPER, UNLABELLED, ClassPalette, draw_texts, error_colors, error_legend
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.surface_io import CHANGE_COLORS

MAX_WIDTH = 960


def _shown_size(width: int, height: int) -> tuple[int, int]:
    """Return (width, height) at which an image of the given size is shown."""
    scale = min(1.0, MAX_WIDTH / width)
    return max(1, round(width * scale)), max(1, round(height * scale))


def depth_picture(depth: Float32Array, scale: RangeScale) -> rr.EncodedImage:
    """Draw depth (H, W), metres, in colours of `scale`, over its legend."""
    # Nearest neighbour: a mean over a ridge line would show a depth that does not exist.
    colors = depth_colors(shrunk(depth, cv2.INTER_NEAREST), scale)
    return jpeg(with_legend(colors, range_legend(colors.shape[1], scale)), 85)


def difference_picture(depth: Float32Array, other: Float32Array) -> rr.EncodedImage:
    """Draw the difference of two depths (H, W), metres, over the legend."""
    colors = error_colors(shrunk(depth, cv2.INTER_NEAREST), shrunk(other, cv2.INTER_NEAREST))
    return jpeg(with_legend(colors, error_legend(colors.shape[1])), 85)


def jpeg(picture: RgbImage, quality: int, **options: float) -> rr.EncodedImage:
    return rr.EncodedImage(contents=to_jpeg(picture, quality), media_type="image/jpeg", **options)


def heat_image(heat: UInt8Array) -> rr.Image:
    """Return the probability of a prompt x 255 (H, W), to be drawn over the photo: transparent at 0, red at 255."""
    shown = shrunk(heat, cv2.INTER_AREA)
    color = np.zeros((*shown.shape, 4), np.uint8)
    color[..., :2] = 255, 40
    color[..., 3] = shown // 4 * 3
    return rr.Image(color, draw_order=2.0)


def pinhole(camera: Camera, image_plane: float) -> rr.Pinhole:
    """Return the camera for the 3D view, with its image `image_plane` metres ahead; distortion is not drawn."""
    width, height = _shown_size(camera.width, camera.height)
    sx, sy = width / camera.width, height / camera.height
    # Rerun counts pixels from the image's corner, we from the first pixel's centre.
    centre = (camera.cx + 0.5) * sx, (camera.cy + 0.5) * sy
    return rr.Pinhole(
        focal_length=(camera.fx * sx, camera.fy * sy),
        principal_point=centre,
        resolution=(width, height),
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=image_plane,
        color=(255, 90, 60),
        line_width=rr.Radius.ui_points(0.6),
    )


def annotation_context(palette: ClassPalette) -> rr.AnnotationContext:
    """Return names and colours of the classes; unlabelled is transparent."""
    classes = [(i, str(name), tuple(map(int, palette.colors[i]))) for i, name in enumerate(palette.names)]
    return rr.AnnotationContext([*classes, (UNLABELLED, "unlabelled", (0, 0, 0, 0))])


def legend(palette: ClassPalette, cell: float) -> rr.EncodedImage:
    """Return the names and colours of the fuel map's classes, and the size of its cells in metres."""
    names = label_legend(560, palette, range(1, len(palette.names)))
    text = draw_texts(np.full((24, 560, 3), PAPER, np.uint8), [(f"Fuel cells of {cell:g} m", 11, 14, "lm")], 13, INK)
    return rr.EncodedImage(contents=to_png(with_legend(names, text)), media_type="image/png")


def shrunk(values: NDArray[Any], method: int) -> NDArray[Any]:
    """Return an image at the size at which it is shown. `method`: OpenCV's interpolation."""
    height, width = values.shape[:2]
    size = _shown_size(width, height)
    return values if size == (width, height) else np.asarray(cv2.resize(values, size, interpolation=method))


PICTURE_PIXELS = 1600
"""Longer side of the image of changes in pixels."""
MAX_POINTS = 60_000
"""Maximum number of changed cells in the 3D view."""
_COLORS = np.array([CHANGE_COLORS[kind] for kind in ChangeKind], np.uint8)


def changed_points(cells: Iterable[tuple[float, float, float, int]]) -> rr.Points3D:
    """Draw changed cells: x, y, z and kind."""
    drawn = np.array(list(cells), np.float64).reshape(-1, 4)
    drawn = drawn[:: 1 + len(drawn) // MAX_POINTS]
    colors = _COLORS[drawn[:, 3].astype(np.int64)]
    return rr.Points3D(drawn[:, :3].astype(np.float32), colors=colors, radii=rr.Radius.ui_points(2.5))


def change_picture(
    kinds: UInt8Array, geometry: GridGeometry, under: GridGeometry
) -> tuple[rr.Transform3D, rr.SegmentationImage]:
    """Return kinds of change (H, W) of a window, 255 unseen, thinned for the screen, and their place on the grid below.

    They are class ids, not a JPEG: the viewer treats a series of JPEGs as a video, whose size is constant."""
    step = max(1, -(-max(geometry.shape) // PICTURE_PIXELS))
    corner = (geometry.x_min - under.x_min) / under.resolution, (under.y_max - geometry.y_max) / under.resolution
    pixel = geometry.resolution * step / under.resolution
    place = rr.Transform3D(translation=(*corner, 0.0), scale=(pixel, pixel, 1.0))
    return place, rr.SegmentationImage(_thinned(kinds, step), opacity=1.0, draw_order=1.0)


def change_classes() -> rr.AnnotationContext:
    """Return colours of the kinds of change; observed ground without change is dimmed."""
    classes = [(kind, kind.name.lower(), (*CHANGE_COLORS[kind], 230)) for kind in ChangeKind]
    classes[ChangeKind.NONE] = (ChangeKind.NONE, "observed", (255, 215, 100, 100))
    return rr.AnnotationContext([*classes, (UNLABELLED, "not observed", (0, 0, 0, 0))])


def _thinned(kinds: UInt8Array, step: int) -> UInt8Array:
    """Return one pixel per block of `step` x `step` cells, changed if any of its cells is."""
    height, width = kinds.shape
    padded = np.full((-(-height // step) * step, -(-width // step) * step), UNLABELLED, np.uint8)
    padded[:height, :width] = kinds
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step)
    changed = np.where(blocks == UNLABELLED, 0, blocks).max(axis=(1, 3))
    looked = (blocks != UNLABELLED).any(axis=(1, 3))
    return np.where(looked, changed, UNLABELLED).astype(np.uint8)
