"""Legend of the height tints of a terrain map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ltm_core.base.types import RgbImage
from ltm_core.pictures.legend import PAPER
from ltm_core.pictures.relief import hypsometric
from ltm_core.raster.dem import Dem
from ltm_lab.evaluation.pictures.figure import picture_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_INCHES = 12.0


def height_legend(dem: Dem, width: int) -> RgbImage:
    """The tints that `terrain_colors` gives this DEM, with their heights in metres, (h, `width`, 3)."""
    return picture_of(height_legend_figure(dem, width))


def height_legend_figure(dem: Dem, width: int) -> Figure:
    """That legend as a figure of `width` pixels."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.figure import Figure

    known = dem.elevation[np.isfinite(dem.elevation)]
    low, high = (float(v) for v in np.percentile(known, [1, 99]))
    high = max(high, low + 1e-3)
    tints = hypsometric(np.linspace(low, high, 256, dtype=np.float32)[None], low, high)[0]
    # Always as many inches: letters grow with the width. A quarter of a pixel: the canvas cuts fractions off.
    figure = Figure(figsize=(_INCHES, 0.85), dpi=(width + 0.25) / _INCHES, facecolor=np.array(PAPER) / 255.0)
    axes = figure.add_axes((0.03, 0.66, 0.94, 0.24))
    colors = ScalarMappable(Normalize(low, high), ListedColormap(tints / 255.0))
    # The lowest and the highest hundredth of the ground have the tints at the ends.
    bar = figure.colorbar(colors, cax=axes, orientation="horizontal", extend="both", extendfrac=0.02)
    bar.ax.tick_params(labelsize=13)
    bar.ax.ticklabel_format(style="plain", useOffset=False)
    bar.set_label("height (m)", size=13)
    return figure
