"""Draws one frame's traced, network and fused depth side by side, with the sources of fusion and the errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ltm_core.base.types import Float32Array, Float64Array, RgbImage
from ltm_core.depth.topodepth import DepthSource, FusedDepth
from ltm_core.pictures.drawing import metres
from ltm_core.pictures.legend import SKY_COLOR, UNKNOWN_COLOR, RangeScale, depth_colors, scale_colors
from ltm_lab.evaluation.pictures.figure import picture_of, swatches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Of unknown and sky as in pictures of depth: one legend tells both.
_SOURCE_COLORS = {
    DepthSource.UNKNOWN: UNKNOWN_COLOR,
    DepthSource.TERRAIN: (196, 170, 120),
    DepthSource.NETWORK: (214, 75, 70),
    DepthSource.BOTH: (110, 160, 190),
    DepthSource.SKY: SKY_COLOR,
}
_LARGEST = 0.5
"""Relative error at the ends of the colour scale."""
_ERROR_TICKS = (-0.5, -0.2, -0.05, 0.0, 0.05, 0.2, 0.5)
_DPI = 100
_PANEL = 6.4
"""Inches of a picture's width."""
_FURNITURE = 0.6
"""Inches of a row's title and legend."""


def depth_sheet(
    title: str,
    photo: RgbImage,
    sources: Mapping[str, Float32Array],
    truth: Float32Array,
    fused: FusedDepth,
) -> RgbImage:
    """A sheet of three columns. `sources`: traced, network and fused depth at the pixels of `truth` (h, w)."""
    return picture_of(depth_figure(title, photo, sources, truth, fused))


def depth_figure(
    title: str,
    photo: RgbImage,
    sources: Mapping[str, Float32Array],
    truth: Float32Array,
    fused: FusedDepth,
) -> Figure:
    """That sheet as a figure: photo, truth and what was fused; then the depths; then their errors."""
    scale = RangeScale.of(truth)
    figure, rows = frame_figure(3, truth.shape)
    show_picture(rows[0][0], photo, title)
    show_depth(rows[0][1], truth, scale, "true depth of the visible surface")
    order = list(_SOURCE_COLORS)
    colors = np.zeros((len(DepthSource), 3), np.uint8)
    colors[order] = list(_SOURCE_COLORS.values())
    show_picture(rows[0][2], colors[fused.source], "what depth is fused from")
    names = swatches([source.name.lower() for source in order], colors[order])
    rows[0][2].legend(handles=names, loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=len(names), frameon=False)
    for axes, name in zip(rows[1], ("traced", "network", "fused"), strict=True):
        show_depth(axes, sources[name], scale, f"{name} depth")
    for axes, name in zip(rows[2], ("traced", "network", "fused"), strict=True):
        show_error(axes, sources[name], truth, f"error of {name} depth")
    depth_bar(figure, [*rows[0], *rows[1]], scale)
    error_bar(figure, rows[2])
    return figure


def frame_figure(rows: int, shape: tuple[int, ...]) -> tuple[Figure, list[list[Axes]]]:
    """A figure of rows of three axes, each for pictures (h, w) of `shape`."""
    from matplotlib.figure import Figure

    height = _PANEL * shape[0] / shape[1] + _FURNITURE
    figure = Figure(figsize=(3 * _PANEL + 1.2, rows * height), dpi=_DPI, layout="constrained")
    axes = figure.subplots(rows, 3, squeeze=False)
    for one in axes.flat:
        one.set(xticks=[], yticks=[])
    return figure, axes.tolist()


def show_picture(axes: Axes, picture: RgbImage, title: str) -> None:
    axes.imshow(picture)
    axes.set_title(title, loc="left")


def show_depth(axes: Axes, depth: Float32Array, scale: RangeScale, title: str) -> None:
    """Depth (h, w), metres, in the colours that `depth_bar` tells."""
    show_picture(axes, depth_colors(depth, scale), title)


def show_error(axes: Axes, depth: Float32Array, truth: Float32Array, title: str) -> None:
    """Relative error (h, w): white none, red too far, blue too near, grey where either is not finite."""
    from matplotlib import colormaps

    with np.errstate(invalid="ignore"):
        error = np.ma.masked_invalid((depth - truth) / truth)
    colors = colormaps["bwr"].with_extremes(bad=(0.588, 0.588, 0.604))
    axes.imshow(error, cmap=colors, norm=_error_norm())
    axes.set_title(title, loc="left")


def depth_bar(figure: Figure, axes: Sequence[Axes], scale: RangeScale) -> None:
    """The colours of depth at the right of `axes`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, LogNorm

    colors = ScalarMappable(LogNorm(scale.near, scale.far), ListedColormap(scale_colors() / 255.0))
    ticks = scale.ticks()
    bar = figure.colorbar(colors, ax=axes, ticks=ticks, label="depth along the optical axis", aspect=40, pad=0.01)
    bar.set_ticks(ticks, labels=[metres(tick) for tick in ticks])
    bar.minorticks_off()


def error_bar(figure: Figure, axes: Sequence[Axes]) -> None:
    """The colours of relative errors at the right of `axes`."""
    colors = axes[-1].images[0]
    label = "error / true depth\n(red too far, blue too near)"
    bar = figure.colorbar(colors, ax=axes, ticks=_ERROR_TICKS, extend="both", label=label, pad=0.01)
    bar.set_ticks(_ERROR_TICKS, labels=[f"{tick:+.0%}" if tick else "0" for tick in _ERROR_TICKS])


def _error_norm() -> Any:
    """Square root: an error of a hundredth shall be seen beside one of a half."""
    from matplotlib.colors import FuncNorm

    return FuncNorm((_root, _square), vmin=-_LARGEST, vmax=_LARGEST)


def _root(error: Float64Array) -> Float64Array:
    return np.sign(error) * np.sqrt(np.abs(error))


def _square(place: Float64Array) -> Float64Array:
    return np.sign(place) * place**2
