"""Maps of a surface's changes on one sheet: how far it moved, its sigma, kinds of change, and change against truth."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import BoolArray, Float32Array, RgbImage, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import PAPER
from ltm_core.pictures.relief import hillshade
from ltm_core.raster.dem import Dem
from ltm_lab.evaluation.pictures.figure import picture_of, swatches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KIND_NAMES = ("unchanged", "removed", "grown", "ground lowered")
KIND_COLORS = np.array([(255, 255, 255), (208, 52, 38), (30, 138, 66), (122, 62, 178)], np.uint8)
SCORE_NAMES = ("found", "false", "missed")
SCORE_COLORS = np.array([(30, 138, 66), (208, 52, 38), (38, 96, 200)], np.uint8)
_DPI = 100
_FURNITURE = 0.9
"""Inches of a row's titles, coordinates and legends."""


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
    """`surface_figure` as a picture; `width`: pixels of a map, about."""
    return picture_of(surface_figure(heights, sigma, shift, change, seen, geometry, truth, width))


def surface_figure(
    heights: Float32Array,
    sigma: Float32Array,
    shift: Float32Array,
    change: UInt8Array,
    seen: BoolArray,
    geometry: GridGeometry,
    truth: BoolArray | None = None,
    width: int = 760,
) -> "Figure":
    """Four maps: shift of the surface, sigma, kinds of change, and the change against the truth where that is known.

    All (H, W) of `geometry`, lengths in metres. Raises RasterError on other shapes."""
    from matplotlib.figure import Figure

    for name, array in (("sigma", sigma), ("shift", shift), ("change", change), ("seen", seen), ("truth", truth)):
        if array is not None and array.shape != heights.shape:
            raise RasterError(f"{name} of {array.shape} does not fit a surface of {heights.shape}")
    changed = change > 0
    limit = float(max(np.ceil(np.nanpercentile(np.abs(shift[changed]), 95)) if changed.any() else 1.0, 1.0))
    doubt = float(max(np.ceil(np.nanpercentile(sigma, 90)) if np.isfinite(sigma).any() else 1.0, 1.0))
    inches = width / _DPI
    high = inches * geometry.height / geometry.width + _FURNITURE
    figure = Figure(figsize=(2 * inches + 0.9, 2 * high), dpi=_DPI, layout="compressed")
    (moved_map, sigma_map), (kind_map, score_map) = figure.subplots(2, 2, sharex=True, sharey=True)

    relief = shaded(heights, geometry)
    moved = np.where(changed, shift, np.float32(np.nan)).astype(np.float32)
    _show_values(moved_map, moved, (-limit, limit), "RdBu", "shift (m)", relief, geometry)
    moved_map.set_title("surface, moved where change was accepted", loc="left")
    _show_values(sigma_map, sigma, (0.0, doubt), "YlOrRd", "sigma (m)", relief, geometry)
    sigma_map.set_title("sigma of what cameras measured", loc="left")
    dark = np.where(seen[..., None], relief, (relief * 0.62).astype(np.uint8))
    kinds = _mixed(dark, KIND_COLORS[np.minimum(change, len(KIND_COLORS) - 1)], changed)
    _show(kind_map, kinds, geometry)
    kind_map.set_title("kind of change; darker: seen by no two independent views", loc="left")
    _name(figure, kind_map, KIND_NAMES[1:], KIND_COLORS[1:])
    score_map.set_visible(truth is not None)
    if truth is not None:
        verdict = np.where(changed & truth, 0, np.where(changed, 1, 2))
        _show(score_map, _mixed(dark, SCORE_COLORS[verdict], (changed | truth) & seen), geometry)
        score_map.set_title("change against the truth, where it was seen", loc="left")
        _name(figure, score_map, SCORE_NAMES, SCORE_COLORS)
    figure.supxlabel("x in the map frame, east (m)", size="medium")
    figure.supylabel("y in the map frame, north (m)", size="medium")
    return figure


def shaded(heights: Float32Array, geometry: GridGeometry) -> RgbImage:
    """Light grey relief (H, W, 3); paper where there is no height."""
    shade = hillshade(Dem(heights, geometry))
    grey = np.where(np.isfinite(shade), np.clip(40 + 225 * np.nan_to_num(shade), 0, 255), PAPER[0])
    return np.repeat(grey.round().astype(np.uint8)[..., None], 3, axis=-1)


def _show(axes: "Axes", picture: RgbImage, geometry: GridGeometry) -> None:
    axes.imshow(picture, extent=(geometry.x_min, geometry.x_max, geometry.y_min, geometry.y_max))


def _name(figure: "Figure", axes: "Axes", names: tuple[str, ...], colors: RgbImage) -> None:
    """A legend under the coordinates."""
    from matplotlib.transforms import offset_copy

    below = offset_copy(axes.transAxes, figure, y=-18, units="points")
    axes.legend(
        handles=swatches(names, colors), loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=below,
        ncols=len(names), frameon=False,
    )  # fmt: skip


def _show_values(
    axes: "Axes",
    values: Float32Array,
    ends: tuple[float, float],
    colors: str,
    label: str,
    relief: RgbImage,
    geometry: GridGeometry,
) -> None:
    """Values over the relief, with their colour bar; bare relief where NaN."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    mappable: Any = ScalarMappable(Normalize(*ends), colors)
    tints = mappable.to_rgba(values, bytes=True)[..., :3]
    _show(axes, _mixed(relief, tints, np.isfinite(values), 0.75), geometry)
    beyond = "both" if ends[0] < 0 else "max"
    axes.figure.colorbar(mappable, ax=axes, extend=beyond, label=label, location="bottom", aspect=40, pad=0.02)


def _mixed(picture: RgbImage, colors: RgbImage, where: BoolArray, opacity: float = 0.82) -> RgbImage:
    """Colours over relief, shaded by it, so that steep ground keeps its shape."""
    tinted = np.clip(colors * (0.4 + 0.62 * picture[..., :1] / 255.0), 0, 255)
    mixed = (picture * (1 - opacity) + tinted * opacity).round().astype(np.uint8)
    return np.asarray(np.where(where[..., None], mixed, picture), np.uint8)
