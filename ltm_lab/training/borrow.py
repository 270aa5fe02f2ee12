"""Data augmentation that mixes real photos and rendered frames: skies, lake reflections, patches of ground.

Photos of shrubland, lakes and houses are few. A network that sees shrubs in rendered frames alone learns that a photo
has none; so photos carry rendered ground, rendered frames real skies, and both now and then a lake. Pictures are
float32 RGB (H, W, 3) in 0..1, labels (H, W) uint8; each function draws from the generator it is given.
"""

from collections.abc import Iterable

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.label_heads.labelled_frames import LAND, UNKNOWN
from ltm_core.vision.labels import Label
from ltm_lab.training.statements import stated
from ltm_lab.training.training_frames import TrainingFrame

Rng = np.random.Generator
Window = tuple[UInt8Array, UInt8Array, Float32Array]
"""Photo (H, W, 3) uint8, its labels, its inverse depth."""

_SKY_LEAST = 0.15  # of a photo's height that must be sky from side to side, for it to lend its sky
_LAND_MOST = 0.02  # of a row of such a sky that may be something else
_PATCH_LEAST = 0.01  # of a window: a smaller patch of ground is not worth its edge


def photo_skies(frames: Iterable[TrainingFrame]) -> list[UInt8Array]:
    """The upper parts of real photos that are sky from side to side, clouds and all; (h, W, 3) uint8."""
    skies = []
    for frame in frames:
        if not frame.ordinal:
            continue
        ground = np.flatnonzero((frame.labels != Label.SKY).mean(axis=1) > _LAND_MOST)
        rows = int(ground[0]) if ground.size else frame.labels.shape[0]
        if rows >= _SKY_LEAST * frame.labels.shape[0]:
            skies.append(frame.image[: max(1, rows - 2)])
    return skies


def photo_sky(size: tuple[int, int], bottom: int, sky: UInt8Array, rng: Rng) -> Float32Array:
    """A photo's sky stretched over the rows above `bottom` of a picture of `size`, mirrored by chance; (H, W, 3)."""
    height, width = size
    part = rng.uniform(0.6, 1.0)  # of its width
    left = int(rng.uniform(0.0, 1.0 - part) * sky.shape[1])
    cut = sky[:, left : left + max(1, int(part * sky.shape[1]))]
    rows = max(1, min(height, bottom))
    new = np.asarray(cv2.resize(cut, (width, rows), interpolation=cv2.INTER_LINEAR), np.float32) / 255.0
    new = new[:, ::-1] if rng.random() < 0.5 else new
    return np.asarray(np.concatenate([new, np.broadcast_to(new[-1:], (height - rows, width, 3))]))


def with_lake(photo: Float32Array, labels: UInt8Array, rng: Rng) -> tuple[Float32Array, UInt8Array]:
    """A lake or river across the land: it mirrors what stands above its far shore, through ripples, in a water colour.

    Labels become WATER there. A picture with little land keeps as it is.
    """
    height, width = labels.shape
    land = land_of(labels)
    rows = np.flatnonzero(land.mean(axis=1) > 0.6)
    if rows.size < height // 5:
        return photo, labels
    shore = rng.uniform(rows[0] + 0.15 * rows.size, rows[0] + 0.9 * rows.size)
    reach = rng.uniform(0.06, 0.7) * height  # rows from the far shore to the near one
    wobble = [fractal_noise((8, width), rng, coarsest=3, octaves=4)[4] - 0.5 for _ in range(2)]
    far = shore + wobble[0] * 0.05 * reach
    near = shore + reach + wobble[1] * 0.6 * reach
    row = np.arange(height, dtype=np.float32)[:, None]
    water = (row > far) & (row < near) & land
    ripples = fractal_noise((height, width), rng, coarsest=int(rng.integers(6, 20)), octaves=3) - 0.5
    below = np.maximum(row - far, 0.0)
    source = far - below * rng.uniform(0.8, 2.0) + ripples * rng.uniform(0.0, 0.4) * (4.0 + below)
    columns = np.broadcast_to(np.arange(width, dtype=np.float32), (height, width)) + ripples * rng.uniform(0.0, 8.0)
    mirror = cv2.remap(
        photo, columns.astype(np.float32), source.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    calm = rng.random() < 0.4
    blur = (1, 2 * int(rng.integers(0, 3)) + 1) if calm else (2 * int(rng.integers(2, 12)) + 1, 7)
    mirror = np.asarray(cv2.blur(np.asarray(mirror, np.float32), blur), np.float32)
    sky = labels == Label.SKY
    above = photo[sky].mean(axis=0) if sky.any() else np.full(3, rng.uniform(0.3, 0.8))
    hue = np.array([rng.uniform(0.1, 0.55), rng.uniform(0.2, 0.55), rng.uniform(0.2, 0.6)])  # silt, algae, deep
    own = above * rng.uniform(0.6, 1.0) if rng.random() < 0.5 else hue
    waves = fractal_noise((height, max(8, width // 6)), rng, coarsest=8, octaves=5, fall=0.8)
    waves = np.asarray(cv2.resize(waves, (width, height)), np.float32)[..., None] - 0.5
    share = rng.uniform(0.0, 0.5) if calm else rng.uniform(0.4, 1.0)
    surface = mirror * (1.0 - share) + own.astype(np.float32) * share
    surface = surface * (1.0 + waves * rng.uniform(0.0, 0.15 if calm else 0.5))
    weight = soft_mask(water)
    changed = np.clip(photo * (1.0 - weight) + surface * weight, 0.0, 1.0)
    return np.asarray(changed, np.float32), np.where(water, np.uint8(Label.WATER), labels)


def with_ground(host: Window, donor: Window, rng: Rng) -> Window:
    """A photo's window with a patch of a rendered window's ground, in colours that approach those of the photo's own.

    What the patch covers takes the donor's labels; its depth is not known.
    """
    photo, labels, inverse = host
    known = land_of(donor[1]) & (donor[1] < LAND)
    blob = fractal_noise((labels.shape[0], labels.shape[1]), rng, coarsest=int(rng.integers(2, 5)), octaves=3)
    patch = (blob > rng.uniform(0.35, 0.6)) & known & land_of(labels)
    if patch.mean() < _PATCH_LEAST:
        return host
    own, lent = (
        np.asarray(cv2.cvtColor(np.asarray(p, np.float32) / 255.0, cv2.COLOR_RGB2LAB)) for p in (photo, donor[0])
    )
    here = own[land_of(labels)]
    mean, spread = lent[patch].mean(axis=0), lent[patch].std(axis=0)
    part = np.float32(rng.uniform(0.3, 1.0))
    gain = np.clip(here.std(axis=0) / np.maximum(spread, 1.0), 0.5, 1.5) ** part
    matched = (lent - mean) * gain + mean + part * (here.mean(axis=0) - mean)
    new = np.clip(np.asarray(cv2.cvtColor(matched.astype(np.float32), cv2.COLOR_LAB2RGB)), 0.0, 1.0) * 255.0
    weight = soft_mask(patch)
    mixed = np.round(photo * (1.0 - weight) + new * weight).astype(np.uint8)
    return mixed, np.where(patch, donor[1], labels), np.where(patch, np.float32(np.nan), inverse)


def land_of(labels: UInt8Array) -> BoolArray:
    """Pixels that are ground of any kind, or of unknown class."""
    return np.asarray((labels != Label.SKY) & (labels != UNKNOWN) & ~stated(labels))


def fractal_noise(
    size: tuple[int, int], rng: np.random.Generator, coarsest: int = 4, octaves: int = 5, fall: float = 0.55
) -> Float32Array:
    """Smooth noise (H, W) in 0..1: `octaves` grids of random values, each twice as fine and `fall` times as strong."""
    height, width = size
    total = np.zeros(size, np.float32)
    for octave in range(octaves):
        cells = coarsest * 2**octave
        grid = rng.random((max(2, cells * height // width), cells), dtype=np.float32)
        total += np.float32(fall**octave) * np.asarray(cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC))
    low, high = total.min(), total.max()
    return np.asarray((total - low) / max(float(high - low), 1e-6), np.float32)


def soft_mask(mask: BoolArray) -> Float32Array:
    """A mask with its edge softened over about two pixels, as a lens would; (H, W, 1)."""
    return np.asarray(cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7), np.float32)[..., None]
