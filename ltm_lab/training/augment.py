"""Data augmentation of rendered frames, so that a network does not learn the look of the renderer.

All work on float32 RGB (H, W, 3) in 0..1 and labels (H, W) uint8; each draws from the generator it is given.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.label_heads.labelled_frames import UNKNOWN
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_lab.training.borrow import fractal_noise, land_of, photo_skies, photo_sky, soft_mask, with_lake
from ltm_lab.training.config import AugmentConfig
from ltm_lab.training.structures import with_structures
from ltm_lab.training.training_frames import TrainingFrame

Rng = np.random.Generator

_LAND_LEAST = 0.1  # of a picture: with less land than this there is no look of it


class Lent(NamedTuple):
    """What the real photos among the training frames lend to all: looks of land, and skies."""

    looks: Float32Array
    skies: list[UInt8Array]

    @classmethod
    def by(cls, frames: Iterable[TrainingFrame]) -> "Lent":
        frames = list(frames)
        return cls(photo_looks(frames), photo_skies(frames))


def augmented(
    frame: TrainingFrame, size: tuple[int, int], chances: AugmentConfig, rng: Rng, lent: Lent | None = None
) -> tuple[UInt8Array, UInt8Array, Float32Array]:
    """A changed copy of a frame at `size` (height, width): photo, labels, inverse depth (NaN where unknown).

    Pixels that a window has from outside its frame are UNKNOWN. `lent`: by photos; rendered land may take on their
    looks, and any frame their skies.
    """
    matrix = _window(frame.labels.shape, size, rng, rescale=rng.random() < chances.rescale)
    if rng.random() < chances.flip:
        matrix = matrix @ np.array([[-1.0, 0.0, size[1] - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    labels = _warped(frame.labels, matrix, size, UNKNOWN)
    inverse = np.full(size, np.nan, np.float32)
    if frame.inverse is not None:
        inverse = _warped(frame.inverse, matrix, size, np.nan)
    image = cv2.warpAffine(
        frame.image,
        matrix,
        size[::-1],
        flags=cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    photo = np.asarray(image, np.float32) / 255.0
    if lent is not None and len(lent.looks) and not frame.ordinal and rng.random() < chances.photo_look:
        photo = _photo_look(photo, labels, lent.looks[int(rng.integers(len(lent.looks)))], rng)
    if rng.random() < chances.ground_tint:
        photo = _ground_tint(photo, labels, rng)
    if rng.random() < chances.snow:
        photo = _snow(photo, labels, rng)
    if chances.photo_sky > 0 and lent is not None and lent.skies and rng.random() < chances.photo_sky:
        sky = lent.skies[int(rng.integers(len(lent.skies)))]
        photo = _under_sky(photo, labels, photo_sky(size, _skyline(labels), sky, rng))
    elif rng.random() < chances.new_sky:
        photo = _new_sky(photo, labels, rng)
    if chances.lake > 0 and rng.random() < chances.lake:  # draws nothing where it is not asked for: old recipes repeat
        photo, labels = with_lake(photo, labels, rng)
        inverse[labels == Label.WATER] = np.nan
    if chances.shade > 0 and rng.random() < chances.shade:
        photo = _shade(photo, labels, rng)
    if chances.structures > 0 and rng.random() < chances.structures:
        photo, labels = with_structures(photo, labels, rng)
        inverse[(labels == Label.BUILT) | (labels == UNKNOWN)] = np.nan
    if rng.random() < chances.haze:
        photo = _haze(photo, labels, rng)
    if rng.random() < chances.light:
        photo = _light(photo, rng)
    if rng.random() < chances.grey:
        photo = np.repeat(photo.mean(axis=2, keepdims=True), 3, axis=2)
    if rng.random() < chances.blur:
        photo = np.asarray(cv2.GaussianBlur(photo, (0, 0), rng.uniform(0.4, 1.6)), np.float32)
    if rng.random() < chances.noise:
        sigma = rng.uniform(0.004, 0.05)
        photo = photo + rng.normal(0.0, sigma, (*size, 1 if rng.random() < 0.4 else 3)).astype(np.float32)
    result = np.round(np.clip(photo, 0.0, 1.0) * 255.0).astype(np.uint8)
    if rng.random() < chances.jpeg:
        _, code = cv2.imencode(".jpg", result, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 90))])
        result = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8)
    return result, labels, inverse


def _window(shape: tuple[int, ...], size: tuple[int, int], rng: Rng, rescale: bool) -> Float64Array:
    """Matrix (2, 3) from the pixels of a window of `size` to those of a frame of `shape`: anywhere in it; with
    `rescale` of another scale, aspect and slight tilt.

    Scales stay near 1: a network that is to tell far trees from shrubs must see them as small as they will come.
    """
    height, width = shape
    target_height, target_width = size
    magnification, aspect, tilt = 1.0, 1.0, 0.0
    if rescale:
        magnification = np.exp(rng.uniform(np.log(0.75), np.log(1.6)))
        aspect = np.exp(rng.uniform(-0.25, 0.25))
        tilt = np.radians(rng.normal(0.0, 3.0))
    # matrix from target pixels to frame pixels
    sy, sx = 1.0 / magnification, aspect / magnification
    room = max(0.0, height - sy * target_height) / 2.0, max(0.0, width - sx * target_width) / 2.0
    middle_row = (height - 1) / 2.0 + rng.uniform(-1.0, 1.0) * room[0]
    middle_col = (width - 1) / 2.0 + rng.uniform(-1.0, 1.0) * room[1]
    cos, sin = np.cos(tilt), np.sin(tilt)
    linear = np.array([[cos * sx, -sin * sy], [sin * sx, cos * sy]])
    middle = np.array([(target_width - 1) / 2.0, (target_height - 1) / 2.0])
    offset = np.array([middle_col, middle_row]) - linear @ middle
    return np.column_stack([linear, offset])


def _warped(values: npt.NDArray[Any], matrix: Float64Array, size: tuple[int, int], outside: float) -> Any:
    """Nearest values of a frame at the pixels of a window; `outside` beyond its edges."""
    flags = cv2.WARP_INVERSE_MAP | cv2.INTER_NEAREST
    return cv2.warpAffine(values, matrix, size[::-1], flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)


def _new_sky(photo: Float32Array, labels: UInt8Array, rng: Rng) -> Float32Array:
    """Another sky: a vertical gradient between two sky colours under fractal clouds, from clear to overcast."""
    height, width = labels.shape
    blue = np.array([rng.uniform(0.15, 0.55), rng.uniform(0.35, 0.7), rng.uniform(0.6, 1.0)])
    warm = np.array([rng.uniform(0.7, 1.0), rng.uniform(0.5, 0.8), rng.uniform(0.3, 0.75)])
    grey = np.full(3, rng.uniform(0.35, 1.0)) + rng.normal(0.0, 0.02, 3)
    top = (blue, blue, grey, warm * 0.8)[rng.integers(4)]
    low = (np.minimum(blue + rng.uniform(0.1, 0.45), 1.0), grey, warm, blue)[rng.integers(4)]
    ramp = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None, None] ** rng.uniform(0.5, 2.0)
    new = np.broadcast_to(top * (1.0 - ramp) + low * ramp, photo.shape)
    if rng.random() < 0.7:
        cover = rng.uniform(0.25, 0.9)
        clouds = fractal_noise((height, width), rng, coarsest=int(rng.integers(2, 7)), fall=rng.uniform(0.45, 0.7))
        density = np.clip((clouds - (1.0 - cover)) / rng.uniform(0.08, 0.5), 0.0, 1.0)[..., None]
        shade = fractal_noise((height, width), rng, coarsest=3)[..., None]
        white = rng.uniform(0.75, 1.05) - rng.uniform(0.0, 0.5) * shade
        new = new * (1.0 - density) + white * density
    return _under_sky(photo, labels, np.asarray(new, np.float32))


def _skyline(labels: UInt8Array) -> int:
    """Row below the lowest sky."""
    rows = np.flatnonzero((labels == Label.SKY).any(axis=1))
    return int(rows[-1]) + 1 if rows.size else 0


def _under_sky(photo: Float32Array, labels: UInt8Array, new: Float32Array) -> Float32Array:
    """The picture with the pixels of `new` (H, W, 3) for its sky."""
    sky = labels == Label.SKY
    if not sky.any():
        return photo
    # Far ranges wear the horizon's colour: they change with it, else their old haze would give the skyline away.
    rows = np.flatnonzero(sky.any(axis=1))
    horizon = sky.copy()
    horizon[: rows[0] + (rows[-1] - rows[0]) * 3 // 4] = False
    shift = (new[horizon].mean(axis=0) + 0.02) / (photo[horizon].mean(axis=0) + 0.02)
    photo = np.where((labels == UNLABELLED)[..., None], photo * shift.astype(np.float32), photo)
    weight = soft_mask(sky)
    return np.asarray(np.clip(photo * (1.0 - weight) + new * weight, 0.0, 1.0), np.float32)


def photo_looks(frames: Iterable[TrainingFrame]) -> Float32Array:
    """The looks of the real photos among frames: those whose depth is a teacher's order."""
    looks = []
    for frame in frames:
        land = land_of(frame.labels)
        if frame.ordinal and land.mean() > _LAND_LEAST:
            colours = _lab(np.asarray(frame.image, np.float32) / 255.0)[land]
            looks.append((colours.mean(axis=0), colours.std(axis=0)))
    return np.array(looks, np.float32).reshape(-1, 2, 3)


def _photo_look(photo: Float32Array, labels: UInt8Array, look: Float32Array, rng: Rng) -> Float32Array:
    """Rendered land with a part of the mean colour and contrast of a real photo's land (Reinhard et al. 2001): film,
    season and light of the world, while what grows there differs among itself as before."""
    land = land_of(labels)
    if land.mean() < _LAND_LEAST:
        return photo
    colours = _lab(photo)
    mean, spread = colours[land].mean(axis=0), colours[land].std(axis=0)
    part = np.float32(rng.uniform(0.2, 0.9))
    gain = np.clip(look[1] / np.maximum(spread, 1.0), 0.5, 2.0) ** part
    changed = (colours - mean) * gain + mean + part * (look[0] - mean)
    new = np.clip(np.asarray(cv2.cvtColor(changed.astype(np.float32), cv2.COLOR_LAB2RGB), np.float32), 0.0, 1.0)
    weight = soft_mask(land)
    return np.asarray(photo * (1.0 - weight) + new * weight, np.float32)


def _lab(photo: Float32Array) -> Float32Array:
    return np.asarray(cv2.cvtColor(photo, cv2.COLOR_RGB2LAB), np.float32)


def _ground_tint(photo: Float32Array, labels: UInt8Array, rng: Rng) -> Float32Array:
    """Each ground class with its own shift of colour and contrast, patchy: other species, soils and seasons."""
    # One row for each value that a label image can hold; ones and zeros leave a pixel as it is.
    first, second = np.ones((256, 3), np.float32), np.ones((256, 3), np.float32)
    contrast, mean = np.ones((256, 1), np.float32), np.zeros((256, 3), np.float32)
    coarse_photo, coarse_labels = photo[::3, ::3], labels[::3, ::3]
    for label in Label:
        mask = coarse_labels == label
        if label == Label.SKY or not mask.any():
            continue
        spread = 0.15  # more, and dry grass could not be told from pale soil
        first[label] = np.exp(rng.normal(0.0, spread, 3) * 0.6 + rng.normal(0.0, spread))
        second[label] = np.exp(rng.normal(0.0, spread, 3) * 0.6 + rng.normal(0.0, spread))
        mean[label] = coarse_photo[mask].mean(axis=0)
        contrast[label] = rng.uniform(0.7, 1.4)
    patches = fractal_noise((labels.shape[0], labels.shape[1]), rng, coarsest=3, octaves=4)[..., None]
    tint = second[labels] + (first - second)[labels] * patches
    level = (mean * (1.0 - contrast))[labels]
    return np.asarray(np.clip((photo * contrast[labels] + level) * tint, 0.0, 1.0), np.float32)


def _snow(photo: Float32Array, labels: UInt8Array, rng: Rng) -> Float32Array:
    """Patches of snow on bare ground (still `bare`: it is not sky, and nothing burns on it)."""
    bare = labels == Label.BARE
    cover = fractal_noise((labels.shape[0], labels.shape[1]), rng, coarsest=5) < rng.uniform(0.3, 0.9)
    weight = soft_mask(bare & cover) * np.float32(rng.uniform(0.6, 1.0))
    shade = photo.mean(axis=2, keepdims=True)
    white = np.clip(0.62 + 0.9 * (shade - shade.mean()) + np.array([0.0, 0.01, 0.04]), 0.0, 1.0)
    return np.asarray(photo * (1.0 - weight) + white * weight, np.float32)


def _shade(photo: Float32Array, labels: UInt8Array, rng: Rng) -> Float32Array:
    """Rock in shade: patches of bare ground, darker, greyer and bluer, as cliffs are that the sun does not reach."""
    bare = labels == Label.BARE
    if not bare.any():
        return photo
    cover = fractal_noise((labels.shape[0], labels.shape[1]), rng, coarsest=int(rng.integers(2, 6))) < rng.uniform(
        0.3, 1.0
    )
    weight = soft_mask(bare & cover)
    grey = photo.mean(axis=2, keepdims=True)
    left = np.float32(rng.uniform(0.0, 0.7))  # of the colour
    dark = (grey + (photo - grey) * left) * np.float32(rng.uniform(0.2, 0.75))
    dark = dark * (1.0 + np.array([-1.0, 0.0, 1.0]) * rng.uniform(-0.05, 0.2)) + np.float32(rng.uniform(0.0, 0.06))
    contrast = np.float32(rng.uniform(0.7, 1.6))  # snow and pale veins stand out
    mean = dark[bare].mean(axis=0)
    dark = np.clip(mean + (dark - mean) * contrast, 0.0, 1.0)
    return np.asarray(photo * (1.0 - weight) + dark * weight, np.float32)


def _haze(photo: Float32Array, labels: UInt8Array, rng: Rng) -> Float32Array:
    """Air light that grows towards the skyline: without a depth image, height in the picture stands for distance."""
    height = labels.shape[0]
    sky_rows = np.flatnonzero((labels == Label.SKY).mean(axis=1) > 0.5)
    skyline = int(sky_rows[-1]) if sky_rows.size else 0
    rows = np.arange(height, dtype=np.float32)
    nearness = np.clip((rows - skyline) / max(1.0, rng.uniform(0.2, 0.9) * height), 0.0, 1.0)
    strength = (rng.uniform(0.1, 0.75) * (1.0 - nearness) ** rng.uniform(1.0, 2.5))[:, None, None]
    air = np.clip(rng.uniform(0.55, 0.95) + rng.normal(0.0, 0.06, 3), 0.0, 1.0)
    return np.asarray(photo * (1.0 - strength) + air * strength, np.float32)


def _light(photo: Float32Array, rng: Rng) -> Float32Array:
    """Exposure, gamma, colour temperature, contrast, saturation and vignetting of another camera and hour."""
    temperature, green = rng.normal(0.0, 0.12), rng.normal(0.0, 0.05)
    gains = np.exp(np.array([temperature, green, -temperature]) + rng.normal(0.0, 0.22))
    gamma = np.float32(np.exp(rng.normal(0.0, 0.22)))
    photo = np.clip(photo * gains.astype(np.float32), 0.0, 1.0) ** gamma
    mean = photo.mean()
    photo = mean + (photo - mean) * rng.uniform(0.6, 1.4)
    grey = photo.mean(axis=2, keepdims=True)
    photo = grey + (photo - grey) * rng.uniform(0.4, 1.5)
    if rng.random() < 0.3:
        height, width = photo.shape[:2]
        y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)[None]
        fall = 1.0 - rng.uniform(0.0, 0.4) * (x**2 + y**2) / 2.0
        photo = photo * fall[..., None].astype(np.float32)
    return np.asarray(np.clip(photo, 0.0, 1.0), np.float32)
