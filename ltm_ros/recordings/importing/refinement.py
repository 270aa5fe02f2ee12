"""Find the poses of imported photos in their images, before they are written.

The compass error of a phone is similar in all photos of a walk (iron in its case and pocket). So photos with a found
pose give the compass error of the others, which are searched again from there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.errors import ImageError, LtmError
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.pipeline.site_surface import site_terrain
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import find_pose
from ltm_core.pose_estimation.skyline.picture_pose_io import (
    UNSTATED_TILT_SIGMA_DEG,
    PoseResult,
    doubt_of_sky,
    result_of,
)
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.site.networks import site_scene_filter, site_segmenter
from ltm_core.site.site import Site
from ltm_core.storage.image_io import decode_rgb
from ltm_core.vision.masks import Looking
from ltm_core.vision.scene_view import SceneFilter
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.recordings.importing.georeference import PlacedPhoto

LEAST_AGREEING, MOST_SPREAD_DEG = 4, 4.0
"""Minimum number of found poses that determine a compass error, and their maximum spread in degrees (1.48 median
absolute deviation)."""
LEAST_SPREAD_DEG = 1.0


@dataclass(frozen=True)
class Refinement:
    """Result of a search. `verdict`: a word and the reason. `accepted`: the pose found in the image is written.
    `as_others`: no certain pose was found, and the compass is corrected like that of the others; anything else: the
    given pose is kept. `turned_deg`: rotation in azimuth, pitch and roll."""

    verdict: str
    reason: str
    turned_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CompassError:
    """Compass error of a camera in degrees, and the standard deviation of single azimuths about it."""

    offset_deg: float
    spread_deg: float

    @classmethod
    def of(cls, turned_deg: Sequence[float]) -> "CompassError | None":
        """Compute it from differences between found and stated azimuths; None if they are few or disagree."""
        if len(turned_deg) < LEAST_AGREEING:
            return None
        offset = float(np.median(turned_deg))
        spread = 1.4826 * float(np.median(np.abs(np.subtract(turned_deg, offset))))
        return None if spread > MOST_SPREAD_DEG else cls(offset, max(spread, LEAST_SPREAD_DEG))

    def corrected(self, prior: PosePrior) -> PosePrior:
        """Return the pose prior with a corrected compass."""
        azimuth, pitch, roll = prior.pose.angles_deg
        pose = Pose.from_angles(prior.pose.position, azimuth + self.offset_deg, pitch, roll)
        # The correction has the uncertainty of a median of a few.
        return replace(prior, pose=pose, azimuth_sigma_deg=1.2 * self.spread_deg)


@dataclass(frozen=True, eq=False)
class _Looked:
    """Result of one photo by itself, from its own prior."""

    prior: PosePrior
    result: PoseResult
    refinement: Refinement


class PoseRefinement:
    """Matches each photo's skyline and ridges with the terrain of `site`, starting from its stated pose. Raises
    DemError at creation."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._terrain = site_terrain(site)
        self._assumed = site.assumed_pose_error.covariance()
        self._views: dict[str, tuple[Segmenter, SceneFilter]] = {}
        """The network that labels each camera's photos, and its mask."""
        self._looked: dict[tuple[str, str], _Looked | str] = {}
        """Results by camera and photo; the reason for a photo that could not be searched."""

    def look(self, camera: str, name: str, item: PlacedPhoto) -> None:
        """Search one photo by itself, before the first one is refined. Raises ModelError, ConfigError."""
        if camera not in self._views:
            self._views[camera] = site_segmenter(self._site, camera), site_scene_filter(self._site, camera)
        try:
            stated = self._stated(item)
            # A photo without a measured tilt was still held roughly level.
            pitch, roll = (min(s, UNSTATED_TILT_SIGMA_DEG) for s in (stated.pitch_sigma_deg, stated.roll_sigma_deg))
            prior = replace(stated, pitch_sigma_deg=pitch, roll_sigma_deg=roll)
            self._looked[camera, name] = _Looked(prior, *self._search(camera, item, prior))
        except LtmError as error:
            self._looked[camera, name] = str(error)

    def refine(self, camera: str, name: str, item: PlacedPhoto) -> tuple[PlacedPhoto, Refinement]:
        """Refine one photo; if it could not be searched (such as beside the DEM), its pose is kept, with the reason."""
        looked = self._looked[camera, name]
        if isinstance(looked, str):
            return item, Refinement("not_searched", looked)
        if looked.result.accepted:
            return _with_pose(item, looked.result), looked.refinement
        others = [
            other.refinement.turned_deg[0]
            for (of, _), other in self._looked.items()
            if of == camera and isinstance(other, _Looked) and other.result.accepted and other.prior.heading_known
        ]
        compass = CompassError.of(others) if looked.prior.heading_known else None
        if compass is None:
            return item, looked.refinement
        result, refinement = self._search(camera, item, compass.corrected(looked.prior))
        if result.accepted:
            return _with_pose(item, result), refinement
        stated = compass.corrected(self._stated(item))
        sigmas = stated.azimuth_sigma_deg, stated.pitch_sigma_deg, stated.roll_sigma_deg
        covariance = pose_covariance(stated.pose, stated.position_sigma, stated.height_sigma, *sigmas)
        reason = (
            f"{refinement.verdict}, {refinement.reason}; the compass error of {len(others)} other photos is "
            f"{-compass.offset_deg:+.1f} +- {compass.spread_deg:.1f} deg"
        )
        told = Refinement("as_others", reason, (compass.offset_deg, 0.0, 0.0))
        return replace(item, pose=stated.pose, covariance=covariance), told

    def _stated(self, item: PlacedPhoto) -> PosePrior:
        return PosePrior.of_covariance(item.pose, self._assumed if item.covariance is None else item.covariance)

    def _search(self, camera: str, item: PlacedPhoto, prior: PosePrior) -> tuple[PoseResult, Refinement]:
        segmenter, scene = self._views[camera]
        photo = decode_rgb(item.photo.data)
        seen = scene.look(photo, Looking.of(item.camera, item.pose))
        labels = segmenter.segment(seen.scene(photo)).labels
        doubt = doubt_of_sky(labels, seen.hidden)
        if doubt is not None:
            raise ImageError(doubt)
        evidence = picture_evidence(photo, labels, item.camera, seen.hidden)
        search = find_pose(evidence, self._terrain, prior)
        result, found = result_of(search, prior, item.camera), Refinement(search.verdict.word, search.verdict.reason)
        if not result.accepted:
            return result, found
        azimuth, pitch, roll = (math.degrees(a) for a in angles_between(item.pose, result.pose))
        return result, replace(found, turned_deg=(azimuth, pitch, roll))


def _with_pose(item: PlacedPhoto, result: PoseResult) -> PlacedPhoto:
    return replace(item, pose=result.pose, camera=result.camera, covariance=result.covariance)
