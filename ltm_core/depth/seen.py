"""A network's fitted depth brought to a photo's size, its edges drawn to the photo's."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.answers import Answers
from ltm_core.depth.guided import guided_coefficients
from ltm_core.depth.network_fit import NetworkFit

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SeenDepth:
    """(H, W) float32 each: `inverse` depth, 1/m; `nearest` and `farthest` that neighbours see. For `answers` and
    `gross` see `NetworkFit`.
    """

    inverse: Image
    nearest: Image
    farthest: Image
    answers: Answers
    gross: float

    @classmethod
    def of(cls, fit: NetworkFit, rgb: NDArray[np.uint8]) -> SeenDepth:
        height, width = rgb.shape[:2]
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        gain, inverse, nearest, farthest = (
            np.asarray(cv2.resize(a, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
            for a in (*guided_coefficients(fit.inverse, grey), fit.nearest, fit.farthest)
        )
        _apply(gain, grey, inverse, nearest, farthest)
        return cls(inverse, nearest, farthest, fit.answers, fit.gross)

    @classmethod
    def none(cls) -> SeenDepth:
        """In place of a network that is not there, for kernels."""
        nothing = np.zeros((1, 1), np.float32)
        return cls(nothing, nothing, nothing, Answers.none(), 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "contract"})  # type: ignore[untyped-decorator]
def _apply(gain: Image, grey: NDArray[np.uint8], inverse: Image, nearest: Image, farthest: Image) -> None:
    """inverse + gain * grey, into `inverse`, and no farther than what neighbours see."""
    for v in range(grey.shape[0]):
        for u in range(grey.shape[1]):
            value = inverse[v, u] + gain[v, u] * np.float32(grey[v, u])
            # Not min and max: NaN has to stay.
            if value > nearest[v, u]:
                value = nearest[v, u]
            if value < farthest[v, u]:
                value = farthest[v, u]
            inverse[v, u] = value
