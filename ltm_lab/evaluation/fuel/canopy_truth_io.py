"""Reads the true canopy of a date of a folder of `ltm-lab simulate`, by fuel cell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import BoolArray, Float32Array
from ltm_core.fuel.canopy import TALL
from ltm_core.fuel.life_form import LifeForm
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.evaluation.truth_frames_io import site_frame


@dataclass(frozen=True, eq=False)
class CanopyTruth:
    """Of the fuel cells of `grid`, in the map frame. `cover`: % of the cell on which trees of 2 m and more stand, and
    `height` their mean, m, both (H, W), NaN where the site ends within the cell. `trees`: whose life form is tree.
    """

    grid: GridGeometry
    cover: Float32Array
    height: Float32Array
    trees: BoolArray


def read_canopy_truth(folder: Path, date: str) -> CanopyTruth:
    """`date`: empty where the folder has one only. Raises RecordingError."""
    frame, place = site_frame(folder), folder / "truth" / date
    form, coarse = _read(place / "life_form.tif")
    canopy, fine = _read(place / "canopy.tif")
    classes, _ = _read(place / "class.tif")
    ratio = round(coarse.resolution / fine.resolution)
    rows, cols = (round((float(v) + 0.5) * ratio) for v in coarse.to_grid(fine.x_min, fine.y_max))
    whole = np.full((coarse.height * ratio, coarse.width * ratio), np.nan, np.float32)
    part = slice(rows, rows + fine.height), slice(cols, cols + fine.width)
    whole[part] = np.where(classes == LifeForm.TREE, canopy, 0.0)
    blocks = whole.reshape(coarse.height, ratio, coarse.width, ratio)
    tall = blocks >= TALL
    count = tall.sum(axis=(1, 3))
    outside = np.isnan(blocks).any(axis=(1, 3))
    height = np.where(tall, blocks, 0).sum(axis=(1, 3)) / np.maximum(count, 1)
    cover = np.where(outside, np.nan, 100 * count / ratio**2)
    grid = coarse.translated(-frame.x_origin, -frame.y_origin)
    known = np.where(outside, np.nan, height)
    return CanopyTruth(grid, cover.astype(np.float32), known.astype(np.float32), form == LifeForm.TREE)


def _read(path: Path) -> tuple[NDArray[Any], GridGeometry]:
    import rasterio

    try:
        with rasterio.open(path) as source:
            t = source.transform
            return source.read(1), GridGeometry(t.c, t.f, t.a, source.width, source.height)
    except (OSError, rasterio.RasterioIOError) as error:
        raise RecordingError(f"{path}: no raster of a simulated site's truth ({error})") from error
