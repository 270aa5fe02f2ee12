"""What of a camera's picture shows the landscape: the one place that decides it, for labels, depth, poses and votes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from ltm_core.errors import ImageError
from ltm_core.site import Site
from ltm_core.types import BoolArray, UInt8Array
from ltm_core.vision.camera_mask import CameraMask
from ltm_core.vision.camera_mask_io import read_mask
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.usable import Unusable, Usability, judge


@dataclass(frozen=True, eq=False)
class SceneView:
    """`hidden`: (H, W) bool, True where something else stands before the landscape; None: nowhere. `usability`: whether
    the picture shows enough of it; None: not judged."""

    hidden: BoolArray | None = None
    usability: Usability | None = None

    @property
    def reason(self) -> Unusable | None:
        """Why nothing of the picture is used; None: it is."""
        return None if self.usability is None else self.usability.reason

    @property
    def unusable(self) -> str:
        """`reason` in words; empty where the picture is used."""
        return "" if self.usability is None else self.usability.said

    @property
    def doubtful(self) -> BoolArray | None:
        """A grid (rows, columns) over the picture: where it is burnt out or black; None: nowhere."""
        if self.usability is None or not self.usability.doubtful.any():
            return None
        return self.usability.doubtful

    def unlabelled(self, labels: UInt8Array, confidence: UInt8Array) -> None:
        """Take labels (H, W) and their confidence (H, W) away, in place: where the landscape is not seen, of a picture
        that is not used, and of land where it is burnt out or black."""
        if self.reason is None and self.hidden is None and self.doubtful is None:
            return
        gone = np.full(labels.shape, self.reason is not None)
        if self.hidden is not None:
            gone |= self.hidden
        if self.doubtful is not None:
            size = labels.shape[::-1]
            cells = cv2.resize(self.doubtful.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
            gone |= cells & (labels != np.uint8(Label.SKY))
        labels[gone] = UNLABELLED
        confidence[gone] = 0


class SceneFilter:
    """Says of each picture of a camera what of it shows the landscape.

    `make`: the camera's mask for pictures of a size (width, height), raising ConfigError where it cannot be; None: it
    has none. `size`: of its pictures, where it is known beforehand. `judged`: whether pictures are judged usable.
    """

    def __init__(
        self,
        make: Callable[[int, int], CameraMask] | None = None,
        size: tuple[int, int] | None = None,
        judged: bool = True,
    ) -> None:
        self._make, self._judged = make, judged
        self.mask = make(*size) if make is not None and size is not None else None
        """As last needed; None: there is none, or no size is known yet."""

    @classmethod
    def of(cls, site: Site, camera: str) -> SceneFilter:
        """As the site file has it. Raises ConfigError for a camera that it lacks, and for a mask that cannot be."""
        config = site.camera(camera)
        if config.mask is None:
            return cls(judged=config.judge_pictures)
        place, calibration = f"cameras.{camera}.mask", config.calibration
        size = None if calibration is None else (calibration.width, calibration.height)
        if not isinstance(config.mask, Path):
            return cls(partial(CameraMask.of_polygons, config.mask, place=place), size, config.judge_pictures)
        return cls.of_png(config.mask, place, size, config.judge_pictures)

    @classmethod
    def of_png(cls, path: Path, place: str, size: tuple[int, int] | None = None, judged: bool = True) -> SceneFilter:
        """With the mask of a PNG; `place`: what names it in errors. Raises ConfigError as `read_mask`, and where it
        does not have the pictures' size."""
        read = read_mask(path, place)

        def fitting(width: int, height: int) -> CameraMask:
            read.check_size(width, height)
            return read

        return cls(fitting, size or read.size, judged)

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
        hidden = self.hidden(picture.shape[1], picture.shape[0])
        return SceneView(hidden, judge(picture, hidden) if self._judged else None)
