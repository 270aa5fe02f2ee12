"""Check imported poses against terrain and photos: impossible ones, and axes and units that fit better than stated."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import LtmError, PoseError
from ltm_core.base.types import UInt8Array
from ltm_core.cameras.foreign_camera import ForeignPose, alternatives
from ltm_core.cameras.plausibility import doubt_of_height
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.pose_estimation.skyline.pose_refinement import SkylineFit, skyline_fit
from ltm_core.raster.dem import Dem

STATED = "as stated"
_LEAST_GAP = 4.0
"""Minimum cost per photo by which other axes or units must fit better to replace the stated ones."""
_TILTED_DEG = 60.0
"""Roll in degrees above which a photo that does not look steeply down is not upright."""


@dataclass(frozen=True, eq=False)
class PlacedPose:
    """A pose in the map frame, with its camera. `problem`: why it is impossible; None if it is not."""

    name: str
    pose: Pose
    camera: Camera
    problem: str | None


@dataclass(frozen=True)
class Reading:
    """One reading of the axes and units. `fits`: mean share of the photos' skylines on the terrain's, and `cost`, per
    photo; None without a photo. `problem`: why it is impossible."""

    how: str
    problem: str | None
    cost: float | None
    fits: float | None


@dataclass(frozen=True, eq=False)
class Placement:
    """The terrain and frame on which poses are placed. `dem` is None without terrain."""

    frame: SiteFrame
    dem: Dem | None
    bend: float
    undulation: float = 0.0

    def ground(self, x: float, y: float) -> float:
        """Return the height of the ground. Raises PoseError without terrain there."""
        height = math.nan if self.dem is None else float(self.dem.elevation_at(x, y))
        if math.isnan(height):
            raise PoseError("the height above the ground needs a DEM that covers the camera; give --dem")
        return height

    def placed(self, foreign: ForeignPose) -> PlacedPose:
        """Return a pose on the terrain. Raises PoseError if its lens is unknown."""
        if foreign.camera is None:
            raise PoseError(f"{foreign.place}: no focal length is known; give --focal and --size or --photos")
        pose = foreign.pose(self.frame, self.ground, self.undulation)
        return PlacedPose(foreign.name, pose, foreign.camera, self._problem(pose, foreign.camera))

    def _problem(self, pose: Pose, camera: Camera) -> str | None:
        _, pitch, roll = pose.angles_deg
        if pitch > -45 and abs(roll) > _TILTED_DEG:
            return f"the camera is rolled by {roll:.0f} deg; a pose file needs the upright photo"
        lowest = pitch - math.degrees(math.atan((camera.height - 1 - camera.cy) / camera.fy))
        if self.dem is None:
            return f"it looks {pitch:.0f} deg up, only at the sky" if lowest > 45 else None
        x, y, z = (float(v) for v in pose.position)
        ground = float(self.dem.elevation_at(x, y))
        if math.isnan(ground):
            place = f"({x + self.frame.x_origin:.0f}, {y + self.frame.y_origin:.0f})"
            return f"the camera at {place} is outside the DEM; check the order of its coordinates and its CRS"
        if z <= ground:
            return doubt_of_height(z, ground)
        if lowest > 0:
            horizon = SearchTerrain(self.dem, self.bend).horizon_for(camera, PosePrior(pose, 1.0))
            known = horizon.tangent[horizon.range > 0]
            if known.size and math.degrees(math.atan(float(known.max()))) < lowest:
                return f"it looks {pitch:.0f} deg up, above all terrain, only at the sky"
        return None

    def fit(self, placed: PlacedPose, photo: UInt8Array, labels: UInt8Array) -> SkylineFit | None:
        """Return the fit of a photo's skyline to the terrain's; None without a skyline or terrain."""
        if self.dem is None or photo.shape[:2] != (placed.camera.height, placed.camera.width):
            return None
        evidence = picture_evidence(photo, labels, placed.camera)
        if evidence.skyline is None:
            return None
        prior = PosePrior(placed.pose, 1.0)
        horizon = SearchTerrain(self.dem, self.bend).horizon_for(evidence.camera, prior)
        return skyline_fit(placed.pose, evidence.camera, PoseProblem(evidence, horizon, prior))


def readings(
    poses: Sequence[ForeignPose], placement: Placement, photos: Mapping[str, tuple[UInt8Array, UInt8Array]]
) -> list[Reading]:
    """Return how well each reading of axes and units explains photos (photo, labels) by name; the stated one first."""
    found: list[Reading] = []
    sample = [pose for pose in poses if pose.name in photos] or list(poses[:3])
    for how in alternatives(sample[0]):
        problem, fits = None, list[SkylineFit]()
        for foreign in sample:
            try:
                placed = placement.placed(alternatives(foreign)[how])
            except (LtmError, KeyError) as error:
                if how == STATED:
                    raise
                problem = str(error)
                break
            problem = placed.problem and f"{foreign.name}: {placed.problem}"
            if problem is not None:
                break
            if foreign.name in photos and (fit := placement.fit(placed, *photos[foreign.name])) is not None:
                fits.append(fit)
        means = [float(np.mean(values)) for values in zip(*((fit.cost, fit.support) for fit in fits), strict=True)]
        cost, share = means if means and problem is None else (None, None)
        found.append(Reading(how, problem, cost, share))
    return found


def chosen_reading(found: Sequence[Reading]) -> Reading:
    """Return the reading to use: the stated one, unless photos fit another one clearly better. Raises PoseError if the
    stated one is impossible and photos do not show which is right."""
    stated = found[0]
    costs = {reading.cost: reading for reading in reversed(found) if reading.cost is not None}
    limit = math.inf if stated.problem is not None else -math.inf if stated.cost is None else stated.cost - _LEAST_GAP
    if costs and min(costs) < limit:
        return costs[min(costs)]
    if stated.problem is not None:
        others = [reading.how for reading in found[1:] if reading.problem is None]
        possible = f"; possible {', or '.join(others)}" if others else ""
        raise PoseError(f"{stated.problem}{possible}. Check axes, units, heights; give --dem and --photos as a test")
    return stated
