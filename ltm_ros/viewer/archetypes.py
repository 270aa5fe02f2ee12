"""Converts core types to Rerun archetypes, small enough to stream: pictures at most 960 pixels wide, photos as JPEG."""

from __future__ import annotations

import colorsys
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ltm_core.base.types import Float32Array, RgbImage, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pictures import RangeScale, depth_colors, range_legend, to_jpeg, with_legend
from ltm_core.pictures.drawing import UNLABELLED, ClassPalette
from ltm_core.pictures.legend import error_colors, error_legend
from ltm_ros.viewer.scene_geometry import TexturedMesh

MAX_WIDTH = 960


def shown_size(width: int, height: int) -> tuple[int, int]:
    """(width, height) at which an image of the given size is shown."""
    scale = min(1.0, MAX_WIDTH / width)
    return max(1, round(width * scale)), max(1, round(height * scale))


def photo(rgb: RgbImage) -> rr.EncodedImage:
    """The camera's image (H, W, 3)."""
    return rr.EncodedImage(contents=to_jpeg(_shrunk(rgb, cv2.INTER_AREA), 80), media_type="image/jpeg")


def depth_picture(depth: Float32Array, scale: RangeScale) -> rr.EncodedImage:
    """Depth (H, W), metres, in colours of `scale`, over its legend."""
    # Nearest: a mean over a ridge line would show a depth at which there is nothing.
    colors = depth_colors(_shrunk(depth, cv2.INTER_NEAREST), scale)
    picture = with_legend(colors, range_legend(colors.shape[1], scale))
    return rr.EncodedImage(contents=to_jpeg(picture, 85), media_type="image/jpeg")


def difference_picture(depth: Float32Array, other: Float32Array) -> rr.EncodedImage:
    """How far two depths (H, W) lie apart, metres, over the legend."""
    colors = error_colors(_shrunk(depth, cv2.INTER_NEAREST), _shrunk(other, cv2.INTER_NEAREST))
    picture = with_legend(colors, error_legend(colors.shape[1]))
    return rr.EncodedImage(contents=to_jpeg(picture, 85), media_type="image/jpeg")


def label_image(labels: UInt8Array) -> rr.SegmentationImage:
    """Class ids (H, W), drawn over the photo."""
    return rr.SegmentationImage(_shrunk(labels, cv2.INTER_NEAREST), opacity=0.55, draw_order=1.0)


def pinhole(camera: Camera, image_plane: float) -> rr.Pinhole:
    """The camera as the 3D view draws it, with its image `image_plane` metres ahead; distortion is not drawn."""
    width, height = shown_size(camera.width, camera.height)
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


def stand(pose: Pose) -> tuple[rr.Transform3D, rr.TransformAxes3D]:
    """Optical frame to map; without the arrows of its axes, which the viewer draws unless told not to."""
    return rr.Transform3D(translation=pose.position, mat3x3=pose.rotation), rr.TransformAxes3D(0.0)


def mesh(textured: TexturedMesh) -> rr.Mesh3D:
    """Without normals: the texture holds the shade already."""
    return rr.Mesh3D(
        vertex_positions=textured.vertices,
        triangle_indices=textured.triangles,
        vertex_texcoords=textured.texcoords,
        albedo_texture=textured.texture,
    )


def annotation_context(palette: ClassPalette) -> rr.AnnotationContext:
    """Names and colours of the classes; unlabelled is clear."""
    classes: list[tuple[int, str, tuple[int, ...]]] = [
        (label, str(name), tuple(int(c) for c in np.asarray(palette.colors[label])))
        for label, name in enumerate(palette.names)
    ]
    return rr.AnnotationContext([*classes, (UNLABELLED, "unlabelled", (0, 0, 0, 0))])


def distinct_color(index: int) -> tuple[int, int, int]:
    """The index-th of a row of bright colours: each hue lies where the row so far leaves the widest gap."""
    golden = (5**0.5 - 1) / 2
    red, green, blue = colorsys.hsv_to_rgb(index * golden % 1.0, (0.35, 0.65, 1.0)[index % 3], 0.95)
    return round(red * 255), round(green * 255), round(blue * 255)


def _shrunk(values: NDArray[Any], method: int) -> NDArray[Any]:
    height, width = values.shape[:2]
    size = shown_size(width, height)
    return values if size == (width, height) else np.asarray(cv2.resize(values, size, interpolation=method))
