"""Draws one frame's traced, network and fused depth side by side, with the sources of fusion and the errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ltm_core.depth.topodepth import FusedDepth, Source
from ltm_core.pictures.legend import range_legend, with_legend
from ltm_core.pictures.panel import fit, panel
from ltm_core.pictures.ranges import RangeScale, depth_colors
from ltm_core.types import Float32Array, RgbImage

_SOURCE_COLORS = {
    Source.UNKNOWN: (70, 70, 74),
    Source.TERRAIN: (196, 170, 120),
    Source.NETWORK: (214, 75, 70),
    Source.BOTH: (110, 160, 190),
    Source.SKY: (222, 232, 240),
}
_LARGEST = 0.5  # relative error at the end of the colour scale


def depth_sheet(
    title: str,
    photo: RgbImage,
    sources: Mapping[str, Float32Array],
    truth: Float32Array,
    fused: FusedDepth,
    width: int = 640,
) -> RgbImage:
    """A sheet of three columns. `sources`: traced, network and fused depth at the pixels of `truth` (h, w)."""
    scale = RangeScale.of(truth)
    pictures: list[tuple[str, RgbImage]] = [(title, photo)]
    true = fit(depth_colors(truth, scale), width)
    pictures.append(("true depth of the visible surface", with_legend(true, range_legend(width, scale))))
    colors = np.zeros((len(Source), 3), np.uint8)
    for source, color in _SOURCE_COLORS.items():
        colors[source] = color
    pictures.append(("fused from: terrain brown, network red, both blue", colors[fused.source]))
    for name in ("traced", "network", "fused"):
        pictures.append((f"{name} depth", depth_colors(sources[name], scale)))
    for name in ("traced", "network", "fused"):
        pictures.append((f"{name}: error / true depth, red too far, blue too near", residual(sources[name], truth)))
    return panel(pictures, columns=3, width=width)


def residual(depth: Float32Array, truth: Float32Array) -> RgbImage:
    """Relative error (h, w) as colour: white none, red too far, blue too near, grey where either is not finite."""
    with np.errstate(invalid="ignore"):
        error = (depth - truth) / truth
    known = np.isfinite(error)
    # Square root: an error of a hundredth shall be seen beside one of a half.
    size = np.sqrt(np.clip(np.abs(np.where(known, error, 0.0)) / _LARGEST, 0.0, 1.0))
    fade = (255 * (1 - size)).astype(np.uint8)
    full = np.full_like(fade, 255)
    far = np.where(known, error, 0.0) > 0
    picture = np.stack([np.where(far, full, fade), fade, np.where(far, fade, full)], axis=-1)
    picture[~known] = (150, 150, 154)
    return np.asarray(picture, np.uint8)
