"""Scores traced depth before and after the surface was confirmed, over what has truly changed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ltm_core.evaluation.terrain.hillside_scenes import HillsideScene
from ltm_core.terrain.observation import DepthFrame
from ltm_core.tracing import TerrainTracer
from ltm_core.types import BoolArray, Float32Array, Int32Array

CHANGED = 1.5
"""Metres by which a cell's true surface has moved that counts as changed: the map's own threshold."""


@dataclass(frozen=True)
class UpdateScore:
    """Frames traced to the terrain as given and to a confirmed surface; of each the median error of depth in metres,
    over the pixels that see a truly changed cell, as it was given or as it is.
    """

    frames_before: int
    frames_after: int
    before: float
    after: float

    @property
    def ratio(self) -> float:
        """Of the median error after to that before."""
        return self.after / self.before


def score_update(
    scene: HillsideScene, frames: Iterable[DepthFrame], depths: Mapping[tuple[str, int], tuple[str, Float32Array]]
) -> UpdateScore:
    """`depths`: by camera and stamp, the version of the surface and the traced depth (H, W); frames that are not among
    them, as one whose process was killed, are left out.
    """
    moved = np.abs(scene.true_now.elevation - scene.given.elevation) >= CHANGED
    given, true = (TerrainTracer(dem) for dem in (scene.given, scene.true_now))
    errors: dict[bool, list[Float32Array]] = {True: [], False: []}
    for frame in frames:
        if (frame.source, frame.stamp_ns) not in depths:
            continue
        version, depth = depths[frame.source, frame.stamp_ns]
        was, now = (tracer.trace(frame.camera, frame.pose) for tracer in (given, true))
        sees = _on(moved, was.cells()) | _on(moved, now.cells())
        truth = now.depth()
        known = sees & np.isfinite(truth) & np.isfinite(depth)
        errors[bool(version)].append(np.abs(depth[known] - truth[known]))
    before, after = (float(np.median(np.concatenate(e))) if e else float("nan") for e in (errors[False], errors[True]))
    return UpdateScore(len(errors[False]), len(errors[True]), before, after)


def _on(cells: BoolArray, places: Int32Array) -> BoolArray:
    """(H, W): whether the (row, col) of a pixel (H, W, 2) is one of `cells`."""
    rows, cols = places[..., 0], places[..., 1]
    inside = (rows >= 0) & (cols >= 0) & (rows < cells.shape[0]) & (cols < cells.shape[1])
    return np.asarray(inside & cells[np.where(inside, rows, 0), np.where(inside, cols, 0)], np.bool_)
