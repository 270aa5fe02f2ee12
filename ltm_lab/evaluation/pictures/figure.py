"""Figures of matplotlib as pictures, without pyplot: that keeps every figure in a global list."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ltm_core.base.types import RgbImage

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch


def picture_of(figure: "Figure") -> RgbImage:
    """The figure at its own size and resolution, (H, W, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    # Once for the ticks, which change as the layout gives axes their size: it then has room for them, and for titles.
    figure.draw_without_rendering()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba(), np.uint8)[..., :3].copy()


def swatches(names: Sequence[str], colors: RgbImage) -> "list[Patch]":
    """What a legend shows for each name: its colour, of (N, 3)."""
    from matplotlib.patches import Patch

    return [
        Patch(facecolor=color / 255.0, edgecolor="0.15", label=name) for name, color in zip(names, colors, strict=True)
    ]
