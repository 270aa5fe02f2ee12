"""Reads depth maps from other sources, such as UniDepth, Depth Pro, Depth Anything or a lidar."""

import math
from pathlib import Path

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array
from ltm_core.storage.config_io import load_array

_LARGEST = 512 << 20
"""Bytes of an .npy file."""


def read_depth_map(folder: Path, camera_name: str, stamp_ns: int, image: tuple[int, ...]) -> Float32Array:
    """Read `FOLDER/CAMERA/STAMP_NS.npy`: depth along the optical axis (h, w) or (1, ..., h, w), NaN unknown.

    `image`: rows and columns of the frame. Raises ImageError if there is no map, if it is not an image of one float
    channel, or if it is rotated by 90 degrees."""
    file = folder / camera_name / f"{stamp_ns}.npy"
    try:
        with file.open("rb") as stream:
            content = stream.read(_LARGEST + 1)
    except OSError as error:
        raise ImageError(f"{folder} has no depth map {camera_name}/{stamp_ns}.npy ({error.strerror})") from error
    if len(content) > _LARGEST:
        raise ImageError(f"{file}: more than {_LARGEST >> 20} MiB; give one float32 per pixel")
    values = load_array(content, str(file), ImageError)
    if values.ndim < 2 or values.size == 0 or values.size != values.shape[-2] * values.shape[-1]:
        raise ImageError(f"{file} has the shape {values.shape}; give one number per pixel")
    if values.dtype.kind != "f":
        raise ImageError(f"{file} has the type {values.dtype}; give float metres or relative depth")
    rows, cols = values.shape[-2:]
    if abs(math.log(cols / rows * image[1] / image[0])) < 0.02 < 0.1 < abs(math.log(image[1] / image[0])):
        raise ImageError(f"{file}: {rows} x {cols} pixels are rotated; the image has {image[0]} x {image[1]}")
    depth: Float32Array = values.reshape(rows, cols).astype("float32")
    return depth
