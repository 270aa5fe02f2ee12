"""Turn a photo and its camera into the tensors of a network, and the network's pixels back into the photo's view."""

import weakref
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import Field, PositiveFloat, model_validator

from ltm_core.base.errors import ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array

DTYPES: Final[dict[str, Any]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}
"""NumPy type of each type of a graph's tensors."""

WORKING_WIDTH: Final = 512
"""Width in pixels at which images are judged; the shipped networks' too, so that a photo is reduced once for all."""

_LEADING: Final = 8
"""Maximum number of tokens before those of patches: one of the class and four registers in DINOv3."""

Constant = bool | int | float | tuple[int | float, ...] | tuple[tuple[int | float, ...], ...]


class InputSpec(StrictModel):
    """The image that the network takes, one per run, and its other inputs.

    A float network gets `(value * scale - mean) / std` for each channel, values 0..255 before; a uint8 network gets the
    bytes unchanged. `fit` says how a photo of another aspect ratio becomes `width` x `height` pixels: `stretch` scales
    both axes; `pad` keeps the aspect ratio and fills the right or lower side with the mean; `aspect` keeps it and
    changes the size, at the same area, rounded to multiples of `multiple` pixels, for networks with free axes.

    `intrinsics` names the input for the camera, whose shape says what it takes: the matrix K (3 x 3), fx, fy, cx, cy
    (4 numbers), the focal length (1 number), all in pixels of the input, or the unit ray of each pixel (3 planes).
    `constants` gives further inputs fixed values, such as `num_tokens`. Those with one row per class run the network
    once for each row (token ids of prompts); its answers are then the classes."""

    width: int = Field(gt=0)
    height: int = Field(gt=0)
    layout: Literal["NCHW", "NHWC"]
    dtype: Literal["float32", "float16", "uint8"]
    channels: Literal["rgb", "bgr"] = "rgb"
    scale: float = Field(default=1.0, gt=0)
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = (1.0, 1.0, 1.0)
    fit: Literal["stretch", "pad", "aspect"] = "stretch"
    multiple: int = Field(default=1, gt=0)
    name: str | None = None  # of the graph's input; needed only if the graph has several
    intrinsics: str | None = None
    constants: dict[str, Constant] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _bytes_stay_bytes(self) -> "InputSpec":
        if self.dtype == "uint8" and (self.scale != 1.0 or any(self.mean) or set(self.std) != {1.0}):
            raise ValueError("scale, mean and std belong to float inputs; remove them for dtype uint8")
        return self

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Return the shape of the input tensor."""
        if self.layout == "NCHW":
            return (1, 3, self.height, self.width)
        return (1, self.height, self.width, 3)


@dataclass(frozen=True, eq=False)
class FittedImage:
    """A photo in the network's size: `pixels` (height, width, 3) uint8 RGB, of which the upper left `rows` x `cols`
    show the photo, edge to edge; the rest is padding."""

    pixels: UInt8Array
    rows: int
    cols: int

    def without_padding(self, planes: Float32Array) -> Float32Array:
        """Return the part of a network's planes (K, h, w), which cover all pixels, that shows the photo.

        If the border is between two of the network's pixels, the part is interpolated, so that it is not shifted."""
        height, width = planes.shape[1:]
        rows, cols = height * self.rows / self.pixels.shape[0], width * self.cols / self.pixels.shape[1]
        tall, wide = max(1, round(rows)), max(1, round(cols))
        if abs(rows - tall) < 1e-6 and abs(cols - wide) < 1e-6:
            return planes[:, :tall, :wide]
        import cv2  # not above: commands that only read manifests start without it

        down, across = rows / tall, cols / wide
        back = np.array([[across, 0, across / 2 - 0.5], [0, down, down / 2 - 0.5]])
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        parts = [cv2.warpAffine(p, back, (wide, tall), flags=how, borderMode=cv2.BORDER_REPLICATE) for p in planes]
        return np.asarray(parts, np.float32)


MadeT = TypeVar("MadeT")
_made: dict[int, tuple[weakref.ref[Any], dict[Hashable, Any]]] = {}


def once(photo: UInt8Array, what: Hashable, make: Callable[[], MadeT]) -> MadeT:
    """Return what `make` makes of a photo; for a read-only photo it is made once while the photo's memory exists, since
    several nodes of a process get the same image."""
    owner: Any = photo
    while isinstance(owner, np.ndarray) and owner.base is not None:
        owner = owner.base
    owner = owner.obj if isinstance(owner, memoryview) else owner
    place = id(owner)
    try:
        alive = None if photo.flags.writeable else weakref.ref(owner, lambda _: _made.pop(place, None))
    except TypeError:  # bytes, for example
        alive = None
    if alive is None:
        return make()
    _, made = _made.setdefault(place, (alive, {}))
    key = photo.ctypes.data, photo.shape, photo.strides, what
    if key not in made:
        made[key] = make()
    return made[key]  # type: ignore[no-any-return]


def shrunk(photo: UInt8Array, width: int, height: int) -> UInt8Array:
    """Return a photo (H, W, 3) reduced by area to another size, which must not be changed."""
    from ltm_core.vision.resampling import reduced_by_area  # not above: it needs numba

    return once(photo, (width, height), lambda: reduced_by_area(photo, width, height))


def working_image(photo: UInt8Array) -> UInt8Array:
    """Return a photo (H, W, 3) reduced to a width of 512 pixels, the size at which images are judged; a smaller one is
    returned as it is. It must not be changed."""
    height, width = photo.shape[:2]
    return (
        photo if width <= WORKING_WIDTH else shrunk(photo, WORKING_WIDTH, max(1, round(height * WORKING_WIDTH / width)))
    )


def fitted(image: UInt8Array, spec: InputSpec) -> FittedImage:
    """Bring a photo (H, W, 3) uint8 RGB to the network's size as `spec.fit` says. Shrinks by area (no aliasing),
    enlarges bilinearly."""
    import cv2

    height, width = image.shape[:2]
    wide, tall = spec.width, spec.height
    if spec.fit == "aspect":
        ratio = np.sqrt(wide * tall / (width * height))
        wide, tall = (max(1, round(side * ratio / spec.multiple)) * spec.multiple for side in (width, height))
    cols, rows = wide, tall
    if spec.fit == "pad":
        ratio = min(wide / width, tall / height)
        cols, rows = (max(1, round(side * ratio)) for side in (width, height))
    if (width, height) != (cols, rows):
        shrinks = cols <= width and rows <= height
        image = shrunk(image, cols, rows) if shrinks else cv2.resize(image, (cols, rows))
    if (cols, rows) != (wide, tall):
        mean = spec.mean if spec.channels == "rgb" else spec.mean[::-1]
        empty = np.clip(np.rint(np.array(mean) / spec.scale), 0, 255)
        image = cv2.copyMakeBorder(image, 0, tall - rows, 0, wide - cols, cv2.BORDER_CONSTANT, value=empty.tolist())
    return FittedImage(np.asarray(image, np.uint8), rows, cols)


def as_tensor(image: UInt8Array, spec: InputSpec) -> npt.NDArray[Any]:
    """Return the tensor of a photo (height, width, 3) uint8 RGB of the network's size."""
    if spec.channels == "bgr":
        image = image[..., ::-1]
    planar = spec.layout == "NCHW"
    tensor: npt.NDArray[Any] = np.moveaxis(image, -1, 0) if planar else image
    if spec.dtype == "uint8":
        return np.ascontiguousarray(tensor[None])
    std = np.asarray(spec.std, dtype=np.float32)
    factor = np.float32(spec.scale) / std
    offset = np.asarray(spec.mean, dtype=np.float32) / std
    tensor = np.array(tensor, np.float32, order="C")
    by_channel = (3, 1, 1) if planar else (3,)
    tensor *= factor.reshape(by_channel)
    tensor -= offset.reshape(by_channel)
    return tensor.astype(spec.dtype, copy=False)[None]


def scaled_matrix(matrix: Float64Array, size: tuple[int, int], to: tuple[int, int]) -> Float64Array:
    """Return the camera matrix (3, 3) of an image of `size` (rows, cols) that is resized `to` (rows, cols)."""
    down, across = to[0] / size[0], to[1] / size[1]
    # Edge to edge: pixel centres move by half a pixel when the image is resized.
    shift = [[across, 0.0, 0.5 * across - 0.5], [0.0, down, 0.5 * down - 0.5], [0.0, 0.0, 1.0]]
    return np.asarray(shift @ matrix, np.float64)


def rows_of(constants: Mapping[str, npt.NDArray[Any]]) -> int:
    """Return how often a network runs for an image: once for each row of its constants."""
    return max((len(value) for value in constants.values() if value.ndim > 1), default=1)


def image_feed(
    image: Any, tensor: npt.NDArray[Any], constants: Mapping[str, npt.NDArray[Any]]
) -> dict[str, npt.NDArray[Any]]:
    """Return what a graph gets for its input node `image` and for its constants."""
    given = tensor[:, None] if len(image.shape) == 5 else tensor
    rows = rows_of(constants)
    return {image.name: np.repeat(given, rows, axis=0) if rows > 1 else given, **constants}


def camera_feed(
    camera: Any, matrix: Float64Array, tensor: npt.NDArray[Any], spec: InputSpec
) -> dict[str, npt.NDArray[Any]]:
    """Return what a graph gets for its input node `camera` (see `InputSpec.intrinsics`), whose free axes count as 1;
    `matrix` (3, 3) is that of the image in `tensor`."""
    shape = tuple(size if isinstance(size, int) else 1 for size in camera.shape)
    numbers = int(np.prod(shape))
    if shape[-2:] == (3, 3):
        given = matrix.reshape(shape)
    elif numbers in (1, 4):
        given = matrix[[0, 1, 0, 1], [0, 1, 2, 2]][:numbers].reshape(shape)  # fx, or fx, fy, cx, cy
    else:
        rays = pixel_rays(matrix, tensor.shape[-2:] if spec.layout == "NCHW" else tensor.shape[1:3])
        rays /= np.linalg.norm(rays, axis=0)
        given = (rays if shape[-1] != 3 else np.moveaxis(rays, 0, -1))[None]
    return {camera.name: given.astype(DTYPES[camera.type])}


def constant_tensor(value: Any, node: Any, size: tuple[int, int]) -> npt.NDArray[Any]:
    """Return the fixed value of an input. One number fills the whole input, whose two last free axes have the image's
    `size` (rows, cols), as in a mask of valid pixels; a list of numbers is one row. Raises ModelError."""
    given = np.asarray(value)
    if given.ndim == 0 and len(node.shape) > 1:
        free = (*(1,) * (len(node.shape) - 2), *size)
        shape = tuple(n if isinstance(n, int) else m for n, m in zip(node.shape, free, strict=True))
        given = np.broadcast_to(given, shape)
    elif given.ndim < len(node.shape):
        given = given.reshape((1,) * (len(node.shape) - given.ndim) + given.shape)
    if node.type not in DTYPES or given.ndim != len(node.shape):
        raise ModelError(f"input.constants: {node.name} is {value}; expected {node.type} {node.shape}")
    return np.ascontiguousarray(given.astype(DTYPES[node.type]))


def pixel_rays(matrix: Float64Array, size: tuple[int, ...]) -> Float64Array:
    """Return x, y, 1 of each pixel's ray (3, rows, cols) for a camera matrix (3, 3)."""
    rows, cols = np.indices(size, dtype=np.float64)
    return np.stack([(cols - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1], np.ones_like(rows)])


def token_planes(tokens: Float32Array, size: tuple[int, int]) -> Float32Array:
    """Return the vectors of patches, tokens (N, D) in reading order, as planes (D, rows, cols).

    `size` (rows, cols): of the network's image; the patches are square. Leading tokens that are no patches (class
    token, registers) are dropped. Raises ModelError if no patch size fits."""
    for side in range(1, min(size) + 1):
        rows, cols = size[0] // side, size[1] // side
        if (rows * side, cols * side) == size and 0 <= len(tokens) - rows * cols <= _LEADING:
            return np.ascontiguousarray(tokens[len(tokens) - rows * cols :].T.reshape(-1, rows, cols))
    raise ModelError(f"{len(tokens)} tokens do not cover an image of {size[1]} x {size[0]} pixels in square patches")


def covered(spec: InputSpec, outputs: Iterable[npt.NDArray[Any]]) -> bool:
    """Return whether the outputs that are images (those of four and more axes if there are any) cover the network's
    image edge to edge."""
    last = [np.moveaxis(v, -1, -3) if v.ndim >= 4 and v.shape[-1] <= 4 else v for v in outputs]
    images = [value for value in last if value.ndim >= 3 and min(value.shape[-2:]) > 4]
    shapes = [value.shape for value in images if value.ndim >= 4] or [value.shape for value in images]
    scales = [(spec.height / shape[-2], spec.width / shape[-1]) for shape in shapes]
    return all(
        abs(down - across) < 1e-9 and (down.is_integer() or (1.0 / down).is_integer()) for down, across in scales
    )
