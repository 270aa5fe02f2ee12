"""Hold one camera image with its calibration and pose."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class PosedImage:
    """`image`: (H, W, 3) uint8 RGB; `stamp_ns`: when it was taken, nanoseconds. Raises ImageError on another shape."""

    image: UInt8Array
    camera: Camera
    pose: Pose
    stamp_ns: int
    camera_name: str

    def __post_init__(self) -> None:
        expected = (self.camera.height, self.camera.width, 3)
        if self.image.shape != expected or self.image.dtype != np.uint8:
            raise ImageError(
                f"image of {self.camera_name} is {self.image.shape} {self.image.dtype}, "
                f"its calibration expects {expected} uint8"
            )
