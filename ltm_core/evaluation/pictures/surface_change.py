"""Pictures of a surface map: shaded relief, sigma, kinds of change, and change against truth."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.dem import Dem
from ltm_core.errors import RasterError
from ltm_core.grid import GridGeometry
from ltm_core.pictures.legend import INK, PAPER
from ltm_core.pictures.maps import scale_bar
from ltm_core.pictures.panel import fit, panel
from ltm_core.pictures.relief import hillshade
from ltm_core.pictures.text import draw_texts, text_width
from ltm_core.types import BoolArray, Float32Array, Float64Array, RgbImage, UInt8Array

KIND_NAMES = ("unchanged", "removed", "grown", "ground lowered")
KIND_COLORS = np.array([(255, 255, 255), (208, 52, 38), (30, 138, 66), (122, 62, 178)], np.uint8)
SCORE_NAMES = ("found", "false", "missed")
SCORE_COLORS = np.array([(30, 138, 66), (208, 52, 38), (38, 96, 200)], np.uint8)


def shaded(heights: Float32Array, geometry: GridGeometry) -> RgbImage:
    """Light grey relief (H, W, 3); paper where there is no height."""
    shade = hillshade(Dem(heights, geometry))
    grey = np.where(np.isfinite(shade), np.clip(40 + 225 * np.nan_to_num(shade), 0, 255), PAPER[0])
    return np.repeat(grey.round().astype(np.uint8)[..., None], 3, axis=-1)


def change_picture(change: UInt8Array, seen: BoolArray, heights: Float32Array, geometry: GridGeometry) -> RgbImage:
    """Kinds of change over the shaded surface, (H, W, 3); what nobody has seen is darker."""
    picture = _dimmed(shaded(heights, geometry), seen)
    return _mixed(picture, KIND_COLORS[np.minimum(change, len(KIND_COLORS) - 1)], change > 0)


def score_picture(
    found: BoolArray,
    truth: BoolArray,
    seen: BoolArray,
    heights: Float32Array,
    geometry: GridGeometry,
) -> RgbImage:
    """Found, false and missed change over the shaded surface; true change that nobody saw stays as it is."""
    picture = _dimmed(shaded(heights, geometry), seen)
    verdict = np.where(found & truth, 0, np.where(found, 1, 2))
    return _mixed(picture, SCORE_COLORS[verdict], (found | truth) & seen)


def values_picture(
    values: Float32Array, limit: float, heights: Float32Array, geometry: GridGeometry, signed: bool
) -> RgbImage:
    """Metres over the shaded surface: signed from -limit (red) over white to limit (blue), or from 0 (pale) to
    `limit` (dark); bare relief where NaN.
    """
    known = np.isfinite(values)
    share = np.nan_to_num(np.asarray(values, np.float64)) / limit
    return _mixed(shaded(heights, geometry), _ramp(np.clip(share, -1.0 if signed else 0.0, 1.0), signed), known, 0.75)


def values_legend(width: int, limit: float, signed: bool, unit: str = "m") -> RgbImage:
    """The ramp of `values_picture` with its ends, (h, `width`, 3)."""
    size = _text_size(width)
    strip = np.full((round(size * 3.0), width, 3), PAPER, np.uint8)
    left, right, top, bar = 2 * size, width - 2 * size, size // 2, size
    strip[top : top + bar, left:right] = _ramp(np.linspace(-1.0 if signed else 0.0, 1.0, right - left), signed)[None]
    ends = ((-limit, left), (0.0, (left + right) / 2), (limit, right)) if signed else ((0.0, left), (limit, right))
    texts = [(f"{value:g} {unit}", x, top + bar + size * 0.4) for value, x in ends]
    return draw_texts(strip, [(text, x, y, "mt") for text, x, y in texts], size, INK)


def names_legend(width: int, names: tuple[str, ...], colors: UInt8Array) -> RgbImage:
    """A swatch and a name for each, in one row, (h, `width`, 3)."""
    size = _text_size(width)
    strip = np.full((round(size * 2.4), width, 3), PAPER, np.uint8)
    x, texts = size, []
    for name, color in zip(names, colors, strict=True):
        swatch = tuple(int(c) for c in color)
        cv2.rectangle(strip, (x, size // 2), (x + size, size // 2 + size), swatch, -1)
        cv2.rectangle(strip, (x, size // 2), (x + size, size // 2 + size), INK, 1)
        texts.append((name, x + size * 1.5, size))
        x += round(size * 2.6) + text_width(name, size)
    return draw_texts(strip, [(text, x, y, "lm") for text, x, y in texts], size, INK)


def surface_sheet(
    heights: Float32Array,
    sigma: Float32Array,
    shift: Float32Array,
    change: UInt8Array,
    seen: BoolArray,
    geometry: GridGeometry,
    truth: BoolArray | None = None,
    width: int = 760,
) -> RgbImage:
    """One sheet: shift of the surface, sigma, kinds of change, and the change against the truth where that is known.

    All (H, W) of `geometry`. Raises RasterError on other shapes.
    """
    for name, array in (("sigma", sigma), ("shift", shift), ("change", change), ("seen", seen), ("truth", truth)):
        if array is not None and array.shape != heights.shape:
            raise RasterError(f"{name} of {array.shape} does not fit a surface of {heights.shape}")
    limit = float(max(np.ceil(np.nanpercentile(np.abs(shift[change > 0]), 95)) if (change > 0).any() else 1.0, 1.0))
    doubt = float(max(np.ceil(np.nanpercentile(sigma, 90)) if np.isfinite(sigma).any() else 1.0, 1.0))
    view = GridGeometry(0.0, 0.0, geometry.width * geometry.resolution / width, width, 1)

    def finished(picture: RgbImage, legend: RgbImage) -> RgbImage:
        return np.concatenate([fit(picture, width), legend], axis=0)

    moved = np.where(change > 0, shift, np.float32(np.nan)).astype(np.float32)
    pictures = [
        (
            "surface, moved where change was accepted",
            finished(values_picture(moved, limit, heights, geometry, True), values_legend(width, limit, True)),
        ),
        (
            "sigma of what cameras measured",
            finished(values_picture(sigma, doubt, heights, geometry, False), values_legend(width, doubt, False)),
        ),
        (
            "kind of change; darker: seen by no two independent views",
            finished(
                change_picture(change, seen, heights, geometry), names_legend(width, KIND_NAMES[1:], KIND_COLORS[1:])
            ),
        ),
    ]
    if truth is not None:
        pictures.append(
            (
                "change against the truth, where it was seen",
                finished(
                    score_picture(change > 0, truth, seen, heights, geometry),
                    names_legend(width, SCORE_NAMES, SCORE_COLORS),
                ),
            )
        )
    sheet = panel(pictures, columns=2, width=width)
    bar = scale_bar(view)
    strip = np.full((bar.shape[0], sheet.shape[1], 3), PAPER, np.uint8)
    strip[:, 14 : 14 + width] = bar
    return np.concatenate([sheet, strip], axis=0)


def _ramp(share: Float64Array, signed: bool) -> RgbImage:
    if signed:
        stops = np.array([-1, -0.5, 0, 0.5, 1])
        colors = np.array([(150, 20, 30), (232, 130, 92), (247, 247, 245), (104, 168, 212), (16, 68, 140)])
    else:
        stops = np.array([0, 0.5, 1])
        colors = np.array([(250, 246, 210), (240, 150, 60), (110, 10, 60)])
    bands = [np.interp(share, stops, colors[:, c]) for c in range(3)]
    return np.asarray(np.stack(bands, axis=-1).round(), np.uint8)


def _mixed(picture: RgbImage, colors: RgbImage, where: BoolArray, opacity: float = 0.82) -> RgbImage:
    """Colours over relief, shaded by it, so that steep ground keeps its shape."""
    tinted = np.clip(colors * (0.4 + 0.62 * picture[..., :1] / 255.0), 0, 255)
    mixed = (picture * (1 - opacity) + tinted * opacity).round().astype(np.uint8)
    return np.asarray(np.where(where[..., None], mixed, picture), np.uint8)


def _dimmed(picture: RgbImage, seen: BoolArray) -> RgbImage:
    return np.where(seen[..., None], picture, (picture * 0.62).astype(np.uint8))


def _text_size(width: int) -> int:
    return max(12, round(width / 48))
