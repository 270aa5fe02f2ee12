"""Reads rendered sites for trials of poses: the terrain, and the frames with the evidence in their images."""

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from inspect import unwrap
from itertools import islice
from pathlib import Path

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.picture_pose_config import BARE_EARTH, CANOPY_SURFACE
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack, with_surface
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.depth.fused_depth import upsampled_labels
from ltm_lab.frames.truth_frames_io import (
    TruthFrame,
    dates,
    is_curved,
    open_dem,
    read_truth_frames,
    site_frame,
)


@dataclass(frozen=True, eq=False)
class PreparedFrame:
    """A frame with the evidence in its image. `open_share` is the share of its horizon beyond which land outside the
    DEM may stand; `seconds` is the processor time of the evidence."""

    number: int
    frame: TruthFrame
    evidence: PictureEvidence
    open_share: float
    seconds: float

    @property
    def unseen(self) -> PictureEvidence:
        """Return the evidence with edges that are not computed yet, to measure the time."""
        return replace(self.evidence, find=cache(unwrap(self.evidence.find)))


@dataclass(frozen=True)
class RenderedSite:
    """A folder of `ltm-lab simulate` and what the search for poses gets of it.

    `model` names the segmentation network; if it is empty, labels are the true ones. `alone` leaves out the DEM of the
    surroundings. `canopy` adds the true surface raster. Of the frames each `every`-th is used."""

    folder: Path
    model: str
    alone: bool = False
    canopy: bool = False
    every: int = 1

    def terrain(self) -> SearchTerrain:
        """Return the DEM of the site within those of its surroundings, at whose end the world ends.

        If the site is `alone`, nothing is known of the land beyond. Raises RecordingError if a raster is missing."""
        frame, dem = site_frame(self.folder), open_dem(self.folder)
        if not self.alone:
            levels = [dem]
            for name in ("dem_around.tif", "dem_region.tif"):
                if not (self.folder / name).is_file():
                    raise RecordingError(
                        f"{self.folder / name} is missing; write it with `ltm-lab simulate SCENARIO "
                        f"--out {self.folder} --site-only`"
                    )
                levels.append(Dem.open(self.folder / name).in_frame(frame))
            dem = DemStack(levels)
        if self.canopy:
            date = next(iter(dates(self.folder)), "now")
            dem = with_surface(dem, Dem.open(self.folder / "truth" / date / "surface.tif").in_frame(frame))
        bend, possible = ray_bend(is_curved(self.folder), 0.13), PossibleGround() if self.alone else NOTHING_BEYOND
        return SearchTerrain(dem, bend, possible, CANOPY_SURFACE if self.canopy else BARE_EARTH)

    def frames(self, terrain: SearchTerrain) -> list[PreparedFrame]:
        """Return the frames with labels and evidence. Raises RecordingError if there is none."""
        segmenter = Segmenter.open(self.model) if self.model else None
        found = []
        for number, frame in islice(enumerate(read_truth_frames(self.folder)), 0, None, self.every):
            shape = (frame.camera.height, frame.camera.width)
            ids = segmenter.segment(frame.photo).labels if segmenter else upsampled_labels(frame.labels, shape)
            found.append(prepared(number, frame, ids, terrain))
        if not found:
            raise RecordingError(f"{self.folder} has no frame with truth")
        return found


def prepared(number: int, frame: TruthFrame, labels: UInt8Array, terrain: SearchTerrain) -> PreparedFrame:
    """Return a frame with its evidence, from the (H, W) labels that the search gets."""
    begin = time.process_time()
    evidence = picture_evidence(frame.photo, labels, frame.camera)
    spent = time.process_time() - begin
    horizon = terrain.horizon_for(evidence.camera, PosePrior(frame.pose, 1.0))
    half = math.radians(frame.camera.hfov_deg) / 2
    away = (horizon.azimuths - math.radians(frame.pose.angles_deg[0]) + math.pi) % (2 * math.pi) - math.pi
    return PreparedFrame(number, frame, evidence, float(horizon.open[np.abs(away) < half].mean()), spent)


def by_camera(frames: Iterable[PreparedFrame]) -> dict[str, list[PreparedFrame]]:
    """Return the frames of each camera, in their order."""
    cameras: dict[str, list[PreparedFrame]] = {}
    for frame in frames:
        cameras.setdefault(frame.frame.camera_name, []).append(frame)
    return cameras
