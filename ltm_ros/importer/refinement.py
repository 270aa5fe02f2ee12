"""Finds the poses of imported photos in their pictures, before they are written.

The compass of a phone is off by much the same in all photos of a walk: by the iron in its case and its pocket. So
photos whose pictures show their pose tell how far off it is in the others, which are sought again from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.errors import ImageError, LtmError
from ltm_core.pose import Pose
from ltm_core.pose_covariance import pose_covariance
from ltm_core.pose_estimation.picture_evidence import picture_evidence
from ltm_core.pose_estimation.picture_pose_io import UNSTATED_TILT_SIGMA_DEG, PoseResult, doubt_of_sky, result_of
from ltm_core.pose_estimation.pose_from_picture import find_pose
from ltm_core.pose_estimation.pose_prior import PosePrior, angles_between
from ltm_core.pose_estimation.site_terrain import site_terrain
from ltm_core.site import Site
from ltm_core.types import UInt8Array
from ltm_core.vision.segmenter import DEFAULT_MODEL, Segmenter
from ltm_msgs_py.image import decode_rgb
from ltm_ros.importer.georeference import PlacedPhoto

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


class PoseRefinement:
    """Lays each photo's skyline and ridges on the terrain of `site`, from what it states of its pose.

    `segment`: labels (H, W) of a photo (H, W, 3); by default those of the shipped network. Raises DemError and
    ModelError when it is made.
    """

    def __init__(self, site: Site, segment: Callable[[UInt8Array], UInt8Array] | None = None) -> None:
        self._terrain, self._config = site_terrain(site)
        self._assumed = site.assumed_pose_error.covariance()
        self._segment = _shipped_labels() if segment is None else segment
        self._found: dict[tuple[str, str], tuple[PoseResult, Refinement]] = {}
        """By camera and photo, of those whose compass told a direction."""

    def look(self, camera: str, name: str, item: PlacedPhoto) -> None:
        """Search one photo by itself; all are looked at before the first is refined."""
        try:
            prior = self._prior(item)
            result, refinement = self._search(item, prior)
        except LtmError:
            return  # `refine` meets it again, and says it
        if result.accepted and prior.heading_known:
            self._found[camera, name] = result, refinement

    def refine(self, camera: str, name: str, item: PlacedPhoto) -> tuple[PlacedPhoto, Refinement]:
        """A photo that cannot be searched, as one beside the DEM, stays as it is: the reason says why."""
        if (camera, name) in self._found:
            result, refinement = self._found[camera, name]
            return _with_pose(item, result), refinement
        try:
            prior = self._prior(item)
            others = [r.turned_deg[0] for (of, _), (_, r) in self._found.items() if of == camera]
            compass = CompassError.of(others) if prior.heading_known else None
            result, refinement = self._search(item, prior if compass is None else compass.corrected(prior))
        except LtmError as error:
            return item, Refinement("not_searched", str(error))
        if result.accepted:
            return _with_pose(item, result), refinement
        if compass is None:
            return item, refinement
        return self._as_others(item, compass, len(others), refinement)

    def _as_others(
        self, item: PlacedPhoto, compass: CompassError, others: int, refinement: Refinement
    ) -> tuple[PlacedPhoto, Refinement]:
        stated = compass.corrected(self._stated(item))
        sigmas = stated.azimuth_sigma_deg, stated.pitch_sigma_deg, stated.roll_sigma_deg
        covariance = pose_covariance(stated.pose, stated.position_sigma, stated.height_sigma, *sigmas)
        reason = (
            f"{refinement.verdict}, {refinement.reason}; by {others} others the compass is {-compass.offset_deg:+.1f} "
            f"+- {compass.spread_deg:.1f} deg off"
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

    def _search(self, item: PlacedPhoto, prior: PosePrior) -> tuple[PoseResult, Refinement]:
        photo = decode_rgb(item.photo.data)
        labels = self._segment(photo)
        doubt = doubt_of_sky(labels)
        if doubt is not None:
            raise ImageError(doubt)
        evidence = picture_evidence(photo, labels, item.camera, self._config)
        search = find_pose(evidence, self._terrain, prior, self._config)
        result = result_of(search, prior, item.camera)
        verdict = search.verdict
        if not result.accepted:
            return result, Refinement(verdict.word, verdict.reason)
        azimuth, pitch, roll = (math.degrees(a) for a in angles_between(item.pose, result.pose))
        return result, Refinement(verdict.word, verdict.reason, (azimuth, pitch, roll))


def _with_pose(item: PlacedPhoto, result: PoseResult) -> PlacedPhoto:
    return replace(item, pose=result.pose, camera=result.camera, covariance=result.covariance)


def _shipped_labels() -> Callable[[UInt8Array], UInt8Array]:
    segmenter = Segmenter.open(DEFAULT_MODEL)
    return lambda photo: segmenter.segment(photo).labels
