"""The pixels of a fixed camera that never show the landscape: lens corners, captions, mast, dishes, its own roof."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from ltm_core.errors import ConfigError
from ltm_core.types import BoolArray, UInt8Array
from ltm_core.vision.mask_config import MaskPolygon


@dataclass(frozen=True, eq=False)
class CameraMask:
    """`hidden`: (H, W) bool, True where the landscape is never seen. `place`: what errors call it.

    Raises ConfigError for a mask that hides nothing, or everything.
    """

    hidden: BoolArray
    place: str

    def __post_init__(self) -> None:
        if not self.hidden.any():
            raise ConfigError(f"{self.place}: the mask hides nothing; draw what it shall hide, or leave the key out")
        if self.hidden.all():
            raise ConfigError(
                f"{self.place}: the mask hides the whole picture, nothing is left to see; masked is what is not 0 in "
                "the PNG: is it inverted?"
            )

    @classmethod
    def of_polygons(cls, polygons: Sequence[MaskPolygon], width: int, height: int, place: str) -> CameraMask:
        """Raises ConfigError, too, where a polygon lies beside a picture of this size."""
        drawn = np.zeros((height, width), np.uint8)
        for number, polygon in enumerate(polygons):
            points = np.array(polygon.polygon, np.float64)
            if (points.max(axis=0) < -0.5).any() or (points.min(axis=0) > (width - 0.5, height - 0.5)).any():
                raise ConfigError(
                    f"{place}.{number}: the polygon lies beside the picture of {width} x {height} pixels (it spans "
                    f"{points.min(axis=0).tolist()} to {points.max(axis=0).tolist()})"
                )
            fill(drawn, points.tolist())
        return cls(drawn > 0, place)

    @cached_property
    def share(self) -> float:
        """Of the picture."""
        return float(self.hidden.mean())

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        return self.hidden.shape[1], self.hidden.shape[0]

    def check_size(self, width: int, height: int) -> None:
        """Raises ConfigError where the camera's pictures have another size."""
        if self.size != (width, height):
            raise ConfigError(
                f"{self.place}: the mask has {self.size[0]} x {self.size[1]} pixels, the camera's pictures have "
                f"{width} x {height}; draw it anew in that size (`ltm mask`)"
            )


def fill(drawn: UInt8Array, polygon: Sequence[Sequence[float]], value: int = 1) -> None:
    """Set the pixels (H, W) whose centres a polygon of (u, v) covers, its edge included."""
    points = np.rint(np.array(polygon, np.float64)).astype(np.int32)
    cv2.fillPoly(drawn, [points.reshape(-1, 1, 2)], [value])
