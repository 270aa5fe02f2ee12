"""Finds the poses of imported photos in their pictures, before they are written.

The compass of a phone is off by much the same in all photos of a walk: by the iron in its case and its pocket. So
photos whose pictures show their pose tell how far off it is in the others, which are sought again from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.errors import ImageError, LtmError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.pipeline.site_surface import site_terrain
from ltm_core.pose_estimation.skyline.find_pose import find_pose
from ltm_core.pose_estimation.skyline.picture_evidence import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_io import (
    UNSTATED_TILT_SIGMA_DEG,
    PoseResult,
    doubt_of_sky,
    result_of,
)
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.site.networks import site_scene_filter, site_segmenter
from ltm_core.site.site import Site
from ltm_core.vision.masks import Looking
from ltm_core.vision.scene_view import SceneFilter
from ltm_core.vision.segmenter import Segmenter
from ltm_msgs_py.image import decode_rgb
from ltm_ros.recordings.importing.georeference import PlacedPhoto

LEAST_AGREEING = 4
"""Found poses that it takes to say how far off a compass is,"""
MOST_SPREAD_DEG = 4.0
"""and by how much (1.48 median absolute deviation) they may differ in it."""
LEAST_SPREAD_DEG = 1.0


@dataclass(frozen=True)
class Refinement:
    """What came of a search. `verdict`: in a word, and why. `accepted`: the picture's pose is written. `as_others`: it
    shows none that is sure, and its compass is corrected as that of the others; anything else: the pose stays as given.
    `turned_deg`: azimuth, pitch and roll by which it was turned."""

    verdict: str
    reason: str
    turned_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CompassError:
    """Degrees by which a camera's azimuths are off, and the standard deviation of single ones about it."""

    offset_deg: float
    spread_deg: float

    @classmethod
    def of(cls, turned_deg: Sequence[float]) -> CompassError | None:
        """From azimuths by which found poses differ from the stated ones; None where they are few or disagree."""
        if len(turned_deg) < LEAST_AGREEING:
            return None
        offset = float(np.median(turned_deg))
        spread = 1.4826 * float(np.median(np.abs(np.subtract(turned_deg, offset))))
        return None if spread > MOST_SPREAD_DEG else cls(offset, max(spread, LEAST_SPREAD_DEG))

    def corrected(self, prior: PosePrior) -> PosePrior:
        """What is known of a pose when its compass is."""
        azimuth, pitch, roll = prior.pose.angles_deg
        pose = Pose.from_angles(prior.pose.position, azimuth + self.offset_deg, pitch, roll)
        # The offset itself is as sure as a median of a few.
        return replace(prior, pose=pose, azimuth_sigma_deg=1.2 * self.spread_deg)


@dataclass(frozen=True, eq=False)
class _CameraView:
    """How a camera's photos are labelled, and what of them shows the landscape."""

    segment: Callable[[UInt8Array], UInt8Array]
    scene: SceneFilter


@dataclass(frozen=True, eq=False)
class _Looked:
    """What came of one photo by itself, from its own prior."""

    prior: PosePrior
    result: PoseResult
    refinement: Refinement


class PoseRefinement:
    """Lays each photo's skyline and ridges on the terrain of `site`, from what it states of its pose.

    `segment`: labels (H, W) of a photo (H, W, 3); by default those of the network and head that the site names for
    each camera. Raises DemError when it is made.
    """

    def __init__(self, site: Site, segment: Callable[[UInt8Array], UInt8Array] | None = None) -> None:
        self._site = site
        self._terrain, self._config = site_terrain(site)
        self._assumed = site.assumed_pose_error.covariance()
        self._segment = segment
        self._views: dict[str, _CameraView] = {}
        self._looked: dict[tuple[str, str], _Looked | str] = {}
        """By camera and photo; why, of a photo that could not be searched."""

    def look(self, camera: str, name: str, item: PlacedPhoto) -> None:
        """Search one photo by itself; all are looked at before the first is refined. Raises ModelError for the
        camera's network, and ConfigError for its mask."""
        view = self._view(camera)
        try:
            prior = self._prior(item)
            self._looked[camera, name] = _Looked(prior, *self._search(item, prior, view))
        except LtmError as error:
            self._looked[camera, name] = str(error)

    def refine(self, camera: str, name: str, item: PlacedPhoto) -> tuple[PlacedPhoto, Refinement]:
        """A photo that could not be searched, as one beside the DEM, stays as it is: the reason says why."""
        looked = self._looked[camera, name]
        if isinstance(looked, str):
            return item, Refinement("not_searched", looked)
        if looked.result.accepted:
            return _with_pose(item, looked.result), looked.refinement
        others = self._compass_errors(camera)
        compass = CompassError.of(others) if looked.prior.heading_known else None
        if compass is None:
            return item, looked.refinement
        result, refinement = self._search(item, compass.corrected(looked.prior), self._view(camera))
        if result.accepted:
            return _with_pose(item, result), refinement
        return self._as_others(item, compass, len(others), refinement)

    def _compass_errors(self, camera: str) -> list[float]:
        """Degrees, of the camera's photos that show their pose, and whose compass told a direction."""
        return [
            looked.refinement.turned_deg[0]
            for (of, _), looked in self._looked.items()
            if of == camera and isinstance(looked, _Looked) and looked.result.accepted and looked.prior.heading_known
        ]

    def _view(self, camera: str) -> _CameraView:
        if camera not in self._views:
            segment = self._segment
            if segment is None:
                segment = _labels_of(site_segmenter(self._site, camera))
            self._views[camera] = _CameraView(segment, site_scene_filter(self._site, camera))
        return self._views[camera]

    def _as_others(
        self, item: PlacedPhoto, compass: CompassError, others: int, refinement: Refinement
    ) -> tuple[PlacedPhoto, Refinement]:
        stated = compass.corrected(self._stated(item))
        sigmas = stated.azimuth_sigma_deg, stated.pitch_sigma_deg, stated.roll_sigma_deg
        covariance = pose_covariance(stated.pose, stated.position_sigma, stated.height_sigma, *sigmas)
        reason = (
            f"{refinement.verdict}, {refinement.reason}; the compass error of {others} other photos is "
            f"{-compass.offset_deg:+.1f} +- {compass.spread_deg:.1f} deg"
        )
        told = Refinement("as_others", reason, (compass.offset_deg, 0.0, 0.0))
        return replace(item, pose=stated.pose, covariance=covariance), told

    def _stated(self, item: PlacedPhoto) -> PosePrior:
        return PosePrior.of_covariance(item.pose, self._assumed if item.covariance is None else item.covariance)

    def _prior(self, item: PlacedPhoto) -> PosePrior:
        """As stated; but a photo whose tilt nobody measured was still held level by hand."""
        stated = self._stated(item)
        pitch, roll = (min(s, UNSTATED_TILT_SIGMA_DEG) for s in (stated.pitch_sigma_deg, stated.roll_sigma_deg))
        return replace(stated, pitch_sigma_deg=pitch, roll_sigma_deg=roll)

    def _search(self, item: PlacedPhoto, prior: PosePrior, view: _CameraView) -> tuple[PoseResult, Refinement]:
        photo = decode_rgb(item.photo.data)
        looking = Looking.of(item.camera, item.pose)
        labels, hidden = view.segment(photo), view.scene.hidden(item.camera.width, item.camera.height, looking)
        doubt = doubt_of_sky(labels, hidden)
        if doubt is not None:
            raise ImageError(doubt)
        evidence = picture_evidence(photo, labels, item.camera, self._config, hidden)
        search = find_pose(evidence, self._terrain, prior, self._config)
        result = result_of(search, prior, item.camera)
        verdict = search.verdict
        if not result.accepted:
            return result, Refinement(verdict.word, verdict.reason)
        azimuth, pitch, roll = (math.degrees(a) for a in angles_between(item.pose, result.pose))
        return result, Refinement(verdict.word, verdict.reason, (azimuth, pitch, roll))


def _labels_of(segmenter: Segmenter) -> Callable[[UInt8Array], UInt8Array]:
    return lambda photo: segmenter.segment(photo).labels


def _with_pose(item: PlacedPhoto, result: PoseResult) -> PlacedPhoto:
    return replace(item, pose=result.pose, camera=result.camera, covariance=result.covariance)
