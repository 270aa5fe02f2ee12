"""What of a camera's picture shows the landscape: the one place that decides it, for labels, depth, poses and votes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ltm_core.errors import ImageError
from ltm_core.site import Site
from ltm_core.types import BoolArray, UInt8Array
from ltm_core.vision.camera_mask import CameraMask
from ltm_core.vision.camera_mask_io import read_mask
from ltm_core.vision.labels import UNLABELLED


@dataclass(frozen=True, eq=False)
class SceneView:
    """`hidden`: (H, W) bool, True where something else stands before the landscape; None: nowhere."""

    hidden: BoolArray | None = None

    def unlabelled(self, labels: UInt8Array, confidence: UInt8Array) -> None:
        """Take labels (H, W) and their confidence (H, W) away where the landscape is not seen, in place."""
        if self.hidden is not None:
            labels[self.hidden] = UNLABELLED
            confidence[self.hidden] = 0


class SceneFilter:
    """Says of each picture of a camera what of it shows the landscape.

    `make`: the camera's mask for pictures of a size (width, height), raising ConfigError where it cannot be; None: it
    has none. `size`: of its pictures, where it is known beforehand.
    """

    def __init__(
        self, make: Callable[[int, int], CameraMask] | None = None, size: tuple[int, int] | None = None
    ) -> None:
        self._make = make
        self.mask = make(*size) if make is not None and size is not None else None
        """As last needed; None: there is none, or no size is known yet."""

    @classmethod
    def of(cls, site: Site, camera: str) -> SceneFilter:
        """As the site file has it. Raises ConfigError for a camera that it lacks, and for a mask that cannot be."""
        config = site.camera(camera)
        if config.mask is None:
            return cls()
        place, calibration = f"cameras.{camera}.mask", config.calibration
        size = None if calibration is None else (calibration.width, calibration.height)
        if not isinstance(config.mask, Path):
            return cls(partial(CameraMask.of_polygons, config.mask, place=place), size)
        return cls.of_png(config.mask, place, size)

    @classmethod
    def of_png(cls, path: Path, place: str, size: tuple[int, int] | None = None) -> SceneFilter:
        """With the mask of a PNG; `place`: what names it in errors. Raises ConfigError as `read_mask`, and where it
        does not have the pictures' size."""
        read = read_mask(path, place)

        def fitting(width: int, height: int) -> CameraMask:
            read.check_size(width, height)
            return read

        return cls(fitting, size or read.size)

    def hidden(self, width: int, height: int) -> BoolArray | None:
        """(H, W) bool, what the mask hides of pictures of this size; None without a mask. Raises ConfigError."""
        if self._make is None:
            return None
        if self.mask is None or self.mask.size != (width, height):
            self.mask = self._make(width, height)
        return self.mask.hidden

    def look(self, picture: UInt8Array) -> SceneView:
        """Of a picture (H, W, 3) RGB. Raises ConfigError where the mask is for another size, ImageError for another
        shape."""
        if picture.ndim != 3 or picture.shape[2] != 3:
            raise ImageError(f"picture is {picture.shape}, expected (H, W, 3) RGB")
        return SceneView(self.hidden(picture.shape[1], picture.shape[0]))
