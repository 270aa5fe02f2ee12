"""Draws the depths of one frame side by side with their errors."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ltm_core.base.types import Float32Array, Float64Array, RgbImage
from ltm_core.pictures import panel, range_legend, with_legend
from ltm_core.pictures.legend import RangeScale, depth_colors, error_colors, error_legend, metres, scale_colors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LARGEST = 0.5
"""Relative error at the ends of the colour scale."""
_ERROR_TICKS = (-0.5, -0.2, -0.05, 0.0, 0.05, 0.2, 0.5)
_WIDTH = 860
"""Pixels of one picture of a sheet."""
_DPI = 100
_PANEL = 6.4
"""Inches of a picture's width."""
_FURNITURE = 0.6
"""Inches of a row's title and legend."""


def depth_sheet(
    title: str, photo: RgbImage, sources: Mapping[str, Float32Array], truth: Float32Array | None
) -> RgbImage:
    """Draw photo and true depth, then each source of depth (h, w) in the same colours and its error."""
    arrays = [*sources.values(), *([] if truth is None else [truth])]
    scale = RangeScale.of(np.concatenate([array[::4, ::4].ravel() for array in arrays]))
    cells: list[tuple[str, RgbImage]] = [(title, photo)]
    if truth is not None:
        cells.append(("true depth of the visible surface", depth_colors(truth, scale)))
    for name, depth in sources.items():
        cells.append((f"{name} depth", depth_colors(depth, scale)))
        if truth is not None:
            both = np.isfinite(depth) & np.isfinite(truth)
            middle = np.median(np.abs(depth[both] - truth[both])) if both.any() else np.nan
            cells.append((f"error of {name} depth, median {middle:.1f} m", error_colors(depth, truth)))
    sheet = panel(cells, 2, _WIDTH)
    return with_legend(sheet, range_legend(sheet.shape[1], scale), error_legend(sheet.shape[1]))


def frame_figure(rows: int, shape: tuple[int, ...]) -> "tuple[Figure, list[list[Axes]]]":
    """A figure of rows of three axes, each for pictures (h, w) of `shape`."""
    from matplotlib.figure import Figure

    height = _PANEL * shape[0] / shape[1] + _FURNITURE
    figure = Figure(figsize=(3 * _PANEL + 1.2, rows * height), dpi=_DPI, layout="constrained")
    axes = figure.subplots(rows, 3, squeeze=False)
    for one in axes.flat:
        one.set(xticks=[], yticks=[])
    return figure, axes.tolist()


def show_picture(axes: "Axes", picture: RgbImage, title: str) -> None:
    axes.imshow(picture)
    axes.set_title(title, loc="left")


def show_depth(axes: "Axes", depth: Float32Array, scale: RangeScale, title: str) -> None:
    """Depth (h, w), metres, in the colours that `depth_bar` tells."""
    show_picture(axes, depth_colors(depth, scale), title)


def show_error(axes: "Axes", depth: Float32Array, truth: Float32Array, title: str) -> None:
    """Relative error (h, w): white none, red too far, blue too near, grey where either is not finite."""
    from matplotlib import colormaps

    with np.errstate(invalid="ignore"):
        error = np.ma.masked_invalid((depth - truth) / truth)
    colors = colormaps["bwr"].with_extremes(bad=(0.588, 0.588, 0.604))
    axes.imshow(error, cmap=colors, norm=_error_norm())
    axes.set_title(title, loc="left")


def depth_bar(figure: "Figure", axes: "Sequence[Axes]", scale: RangeScale) -> None:
    """The colours of depth at the right of `axes`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, LogNorm

    colors = ScalarMappable(LogNorm(scale.near, scale.far), ListedColormap(scale_colors() / 255.0))
    ticks = scale.ticks()
    bar = figure.colorbar(colors, ax=axes, ticks=ticks, label="depth along the optical axis", aspect=40, pad=0.01)
    bar.set_ticks(ticks, labels=[metres(tick) for tick in ticks])
    bar.minorticks_off()


def error_bar(figure: "Figure", axes: "Sequence[Axes]") -> None:
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
