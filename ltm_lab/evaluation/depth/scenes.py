"""Frames with true depth, rendered, recorded or real, with what the system knows of their place."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pose_estimation.points.resection import Resection, resect
from ltm_core.raster.dem import Dem
from ltm_core.storage.image_io import read_rgb
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround
from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_lab.evaluation.gallery.posed import ENGABREEN_POSITION, ENGABREEN_STATED, STEP
from ltm_lab.evaluation.gallery.real_photos_io import (
    ENGABREEN,
    ENGABREEN_PHOTOS,
    read_engabreen_points,
    read_glacier,
)
from ltm_lab.evaluation.terrain.canyon_io import FRAME, PHOTOS, SURVEYS, read_canyon
from ltm_lab.frames.truth_frames_io import TruthFrame, is_curved, open_dem, read_truth_frames, site_frame

_COARSE = 10
"""Cells of Engabreen's lidar DEM that the system gets as one: 30 m, as of a global DEM."""


@dataclass(frozen=True, eq=False)
class Scene:
    """`dem`: the terrain that the system is given, in the map frame `frame`. `model`: the label network of the site."""

    dem: Dem
    frames: Iterable[TruthFrame]
    curved: bool
    frame: SiteFrame
    possible: PossibleGround = NOTHING_BEYOND
    model: str = DEFAULT_MODEL


def open_scene(place: Path, site: Path | None = None, date: str = "") -> Scene:
    """Open a folder of `ltm-lab simulate`, the folder `engabreen` or `grandcanyon_rm22` of real photos, or a recording
    with truth. Raises LtmError, also while frames are read."""
    if (place / "frames.json").is_file():
        return Scene(open_dem(place), read_truth_frames(place, date), is_curved(place), site_frame(place))
    if (place / ENGABREEN_PHOTOS[0]).is_file():
        return _engabreen(place)
    if (place / PHOTOS[min(PHOTOS)]).is_file():
        return _canyon(place)
    from ltm_lab.evaluation.dated_run import DatedRun
    from ltm_lab.frames.truth_frames import recorded_truth_frames

    recorded = DatedRun.find(place, site)
    own = recorded.site
    frames = recorded_truth_frames(place, own)
    return Scene(own.open_dem(), frames, own.curvature, own.frame, own.possible_ground, own.model)


def _engabreen(folder: Path) -> Scene:
    """Truth is the lidar DEM of 3 m; the system gets its mean over 30 m."""
    dem, _ = read_glacier(folder.parent)
    fit = resect(
        read_engabreen_points(folder.parent), ENGABREEN_STATED, ENGABREEN_POSITION, bend=TerrainTracer(dem).bend
    )
    g, n = dem.geometry, _COARSE
    rows, cols = g.height // n, g.width // n
    blocks = dem.elevation[: rows * n, : cols * n].reshape(rows, n, cols, n)
    grid = GridGeometry(g.x_min, g.y_max, g.resolution * n, cols, rows, g.crs)
    coarse = Dem(np.ascontiguousarray(blocks.mean(axis=(1, 3)), np.float32), grid)
    photos = ((Path(name).stem, read_rgb(folder / name)[::STEP, ::STEP]) for name in ENGABREEN_PHOTOS)
    return Scene(coarse, (_photo_frame(*one, k, fit, dem) for k, one in enumerate(photos)), True, ENGABREEN)


def _canyon(folder: Path) -> Scene:
    """Truth is the survey of each photo's day; the system gets the oldest one."""
    site = read_canyon(folder)
    frames = (
        _photo_frame(day, site.photo(day, STEP), k, site.resection, site.surveys[day]) for k, day in enumerate(PHOTOS)
    )
    return Scene(site.surveys[SURVEYS[0]], frames, True, FRAME)


def _photo_frame(name: str, photo: UInt8Array, number: int, fit: Resection, truth: Dem) -> TruthFrame:
    camera: Camera = fit.camera.scaled(STEP)
    depth = TerrainTracer(truth).trace(camera.scaled(2), fit.pose).depth()
    labels, changed = np.full(depth.shape, 255, np.uint8), np.zeros(depth.shape, np.bool_)
    return TruthFrame(name, number, camera, fit.pose, np.ascontiguousarray(photo), depth, depth, labels, changed)
