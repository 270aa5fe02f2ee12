"""Judge at low cost whether an image shows enough of the landscape to be used, and in which parts.

By night, at dusk, in fog, in glare, with a blank or a blurred image, a network names what it was taught to see. Such
an image does not vote. The judgement is of one image, reduced to some 480 columns, and of how high the sun stood: a
few milliseconds at most.

The constants were chosen on half of a set of mountain photos, as they are and spoilt on purpose, and on renderings;
`ltm-lab eval usable` scores them on others."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.vision.network_image import working_image

ROWS, COLUMNS = 9, 12  # rows and columns of the grid on which regions are classified

_BLANK = 1.5  # standard deviation of grey levels below which an image is blank
_NIGHT = 60.0  # grey level below which 95 % of a night image lies
_BLACK_SKY = 40.0
"""Value of the brightest channel below which 90 % of the upper quarter of a floodlit or infrared night lies. It applies
to a low or unknown sun; of 340 photos by day, two from inside cars are as dark there."""
_DIM, _LOW_SUN_DEG = 145.0, 5.0
"""Grey level for a low sun, and the sun's elevation in degrees below which it applies, because the camera has not
compensated for the missing light. A dark forest is as dim at noon, so neither value is sufficient alone. Chosen on
rendered months (`ltm-lab bench archive --month`), in which all plants turn into darker ones in such images; 11 of 159
mountain photos are as dim."""
_GLARE, _GLARE_BELOW = 0.35, 0.2  # shares of the image, and of its lower half, that are overexposed
_BURNT, _BLACK = 245, 14  # levels above which all channels, or below which none, carry information
_CONTRAST = 1.5  # local contrast in grey levels above which a cell of the grid shows something
_FOG = 0.06  # share of the cells that show something below which an image is classified as fog
_BLUR = 0.2  # ratio of fine to coarse contrast below which an image is blurred (out of focus, or a wet lens)
_BLUR_CONTRAST = 1.0  # coarse contrast of the best cells above which blur can be detected
_REGION = 0.6  # share of overexposed or black pixels above which a cell is not used


class Unusable(StrEnum):
    """Reason why an image is unusable."""

    BLANK = "blank"
    NIGHT = "night"
    DUSK = "dusk"
    GLARE = "glare"
    FOG = "fog"
    BLUR = "blur"


_SAID = {
    None: "",
    Unusable.BLANK: "blank: the image has one colour",
    Unusable.NIGHT: "night: the image is too dark",
    Unusable.DUSK: "dusk: the sun is low and the image dim",
    Unusable.GLARE: "glare: too much of the image is overexposed",
    Unusable.FOG: "fog: the image has no contrast anywhere",
    Unusable.BLUR: "blur: the image has no fine detail; out of focus, or a wet or dirty lens",
}


@dataclass(frozen=True, eq=False)
class Usability:
    """Usability of an image. `reason`: None if usable. `doubtful`: (ROWS, COLUMNS), overexposed or black cells."""

    reason: Unusable | None
    doubtful: BoolArray

    @property
    def said(self) -> str:
        """Return the reason in words; empty if the image is usable."""
        return _SAID[self.reason]


def judge(picture: UInt8Array, hidden: BoolArray | None = None, sun_deg: float | None = None) -> Usability:
    """Judge an image (H, W, 3) RGB. `hidden`: (H, W) bool, masked pixels, which are ignored; None: none. `sun_deg`: the
    sun's elevation, degrees; None: unknown."""
    small = working_image(picture)
    size = small.shape[1], small.shape[0]
    levels = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    grey = levels.astype(np.float32)
    fine = cv2.absdiff(grey, cv2.GaussianBlur(grey, (7, 7), 1.0))
    # The coarse contrast has no fine detail, so half the size says as much.
    half = cv2.resize(grey, (max(1, size[0] // 2), max(1, size[1] // 2)), interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(half, (7, 7), 1.0)
    coarse = cv2.absdiff(smooth, cv2.GaussianBlur(smooth, (17, 17), 2.8))
    red, green, blue = cv2.split(small)
    burnt = (cv2.min(cv2.min(red, green), blue) >= _BURNT).astype(np.float32)
    brightest = cv2.max(cv2.max(red, green), blue)
    black = (brightest <= _BLACK).astype(np.float32)
    seen = np.ones(grey.shape, np.bool_)
    if hidden is not None:
        seen = cv2.resize(hidden.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
        # What is masked, and its edge, has no say.
        inner = cv2.erode(seen.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        within = cv2.resize(inner.astype(np.uint8), coarse.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
        fine, coarse = np.where(inner, fine, 0), np.where(within, coarse, 0)
        burnt, black = burnt * seen, black * seen
    if not seen.any():
        return Usability(Unusable.BLANK, np.ones((ROWS, COLUMNS), np.bool_))
    share = _to_grid(seen.astype(np.float32))
    known = share > 0.3  # cells of which enough is visible
    most = np.maximum(share, np.float32(1e-3))
    doubtful = (_to_grid(burnt) / most >= _REGION) | (_to_grid(black) / most >= _REGION)
    upper = brightest[: len(levels) // 4][seen[: len(seen) // 4]]
    black_sky = upper.size > 0 and float(np.percentile(upper, 90)) < _BLACK_SKY
    levels = levels if hidden is None else levels[seen]
    low = sun_deg is not None and sun_deg < _LOW_SUN_DEG
    reason = _reason(levels, (_to_grid(fine) / most)[known], (_to_grid(coarse) / most)[known], burnt, low)
    if reason is None and black_sky and (low or sun_deg is None):
        reason = Unusable.NIGHT
    return Usability(reason, doubtful & known)


def _to_grid(values: NDArray[Any]) -> Float32Array:
    grid = cv2.resize(np.asarray(values, np.float32), (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    return np.asarray(grid, np.float32)


def _reason(
    levels: UInt8Array, fine: NDArray[Any], coarse: NDArray[Any], burnt: Float32Array, low_sun: bool
) -> Unusable | None:
    """Return why an image is unusable. `levels`: visible grey; `fine`, `coarse`: contrast (N,); `burnt`: (h, w)."""
    if float(cv2.meanStdDev(levels)[1].item()) < _BLANK:
        return Unusable.BLANK
    counts = np.cumsum(cv2.calcHist([levels], [0], None, [256], [0, 256]).ravel())
    bright = int(np.searchsorted(counts, 0.95 * counts[-1]))
    if bright < _NIGHT:
        return Unusable.NIGHT
    if low_sun and bright < _DIM:
        return Unusable.DUSK
    if float(burnt.mean()) > _GLARE and float(burnt[len(burnt) // 2 :].mean()) > _GLARE_BELOW:
        return Unusable.GLARE
    if not len(coarse):
        return None
    if float((coarse > _CONTRAST).mean()) < _FOG:
        return Unusable.FOG
    best = coarse >= np.percentile(coarse, 70)
    sharpness = float(fine[best].sum() / (coarse[best].sum() + 0.3))
    blurred = sharpness < _BLUR and float(np.percentile(coarse, 90)) > _BLUR_CONTRAST
    return Unusable.BLUR if blurred else None
