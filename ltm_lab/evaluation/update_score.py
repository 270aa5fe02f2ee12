"""Scores and draws traced depth before and after the surface was confirmed, over what has truly changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Int32Array, RgbImage
from ltm_core.pictures.legend import RangeScale
from ltm_core.surface.observation import DepthFrame
from ltm_core.tracing import TerrainTracer
from ltm_lab.evaluation.pictures.depth_sheet import depth_bar, error_bar, frame_figure, show_depth, show_error
from ltm_lab.evaluation.pictures.figure import picture_of
from ltm_lab.evaluation.terrain.hillside_scenes import HillsideScene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANGED = 1.5
"""Metres by which a cell's true surface has moved that counts as changed: the map's own threshold."""


@dataclass(frozen=True)
class UpdateScore:
    """Frames that were traced to the terrain as given, before any surface was confirmed, and those of the later half;
    of each the median error of depth in metres, over the pixels that see a truly changed cell, as it was given or as
    it is. `followed`: of the later frames, those that were traced to a confirmed surface.
    """

    frames_before: int
    frames_after: int
    followed: int
    before: float
    after: float

    @property
    def ratio(self) -> float:
        """Of the median error after to that before."""
        return self.after / self.before


def score_update(
    scene: HillsideScene, frames: Sequence[DepthFrame], depths: Mapping[tuple[str, int], tuple[str, Float32Array]]
) -> UpdateScore:
    """`depths`: by camera and stamp, the version of the surface and the traced depth (H, W); frames that are not among
    them, as one whose process was killed, are left out.
    """
    moved = np.abs(scene.true_now.elevation - scene.given.elevation) >= CHANGED
    given, true = (TerrainTracer(dem) for dem in (scene.given, scene.true_now))
    before: list[Float32Array] = []
    after: list[Float32Array] = []
    followed = 0
    for number, frame in enumerate(frames):
        version, depth = depths.get((frame.source, frame.stamp_ns), ("", None))
        later = number >= len(frames) // 2
        if depth is None or (version and not later):
            continue
        was, now = (tracer.trace(frame.camera, frame.pose) for tracer in (given, true))
        truth = now.depth()
        known = np.isfinite(truth) & np.isfinite(depth) & (_on(moved, was.cells()) | _on(moved, now.cells()))
        (after if later else before).append(np.abs(depth[known] - truth[known]))
        followed += later and bool(version)
    medians = (float(np.median(np.concatenate(errors))) if errors else float("nan") for errors in (before, after))
    return UpdateScore(len(before), len(after), followed, *medians)


def update_sheet(
    scene: HillsideScene, frames: Sequence[DepthFrame], depths: Mapping[tuple[str, int], tuple[str, Float32Array]]
) -> RgbImage:
    """`update_figure` as a picture."""
    return picture_of(update_figure(scene, frames, depths))


def update_figure(
    scene: HillsideScene, frames: Sequence[DepthFrame], depths: Mapping[tuple[str, int], tuple[str, Float32Array]]
) -> Figure:
    """The last frame of the first camera: what is seen now, and the errors of the depth that is traced to the terrain
    as it was given, and of the depth that it has.
    """
    frame = next(one for one in reversed(frames) if one.source == frames[0].source)
    true, given = (TerrainTracer(dem).trace(frame.camera, frame.pose).depth() for dem in (scene.true_now, scene.given))
    version, traced = depths[frame.source, frame.stamp_ns]
    figure, rows = frame_figure(1, true.shape)
    scale = RangeScale.of(true)
    show_depth(rows[0][0], true, scale, f"{scene.name}, a made scene: true depth")
    show_error(rows[0][1], given, true, "error of depth traced to the terrain as given")
    show_error(rows[0][2], traced, true, f"error of depth traced to surface {version or 'as given'}")
    depth_bar(figure, rows[0][:1], scale)
    error_bar(figure, rows[0][1:])
    return figure


def _on(cells: BoolArray, places: Int32Array) -> BoolArray:
    """(H, W): whether the (row, col) of a pixel (H, W, 2) is one of `cells`."""
    rows, cols = places[..., 0], places[..., 1]
    inside = (rows >= 0) & (cols >= 0) & (rows < cells.shape[0]) & (cols < cells.shape[1])
    return np.asarray(inside & cells[np.where(inside, rows, 0), np.where(inside, cols, 0)], np.bool_)
