"""Whether a correction of a mount that its pictures were fitted with together is to be taken."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ltm_core.pose import Pose
from ltm_core.pose_estimation.mount_pictures import MountPicture
from ltm_core.pose_estimation.picture_pose_config import VerdictConfig
from ltm_core.pose_estimation.pose_prior import angles_between
from ltm_core.pose_estimation.pose_refinement import SkylineFit
from ltm_core.pose_estimation.pose_verdict import MANY_PLANTS, Word
from ltm_core.types import Float64Array


def judge_mount(
    pictures: Sequence[MountPicture],
    found: Sequence[Pose],
    seen: SkylineFit,
    turns_deg: Float64Array,
    gap: float,
    away: float,
    config: VerdictConfig,
) -> tuple[Word, str]:
    """The verdict in a word, and why. `found`: poses of the pictures with the correction. `seen`: how their skylines
    lie on the terrain's there. `turns_deg` (3,): sigmas of its rotation about the map's axes. `gap`: by which the next
    best correction costs more. `away`: sigmas of what is stated by which it is from none, the most of any angle.
    """
    apart = _alone_apart(pictures, found, config.mount_sharp_deg)
    if turns_deg.max() > config.most_sigma_deg or turns_deg[2] > config.mount_azimuth_sigma_deg:
        return "ambiguous", f"the pictures leave the mount open by {turns_deg.max():.2f} deg"
    if gap < _gap_asked(pictures, seen, config):
        return "ambiguous", f"another azimuth of the mount costs {gap:.1f} more only"
    if seen.support < config.least_support:
        return "ambiguous", f"only {seen.support:.0%} of the photos' skylines lies on the terrain's"
    if max(apart, default=0.0) > config.mount_apart_deg:
        return "ambiguous", f"a picture that is sure of itself lies {max(apart):.1f} deg from where the mount puts it"
    if seen.open > config.open_share and not _told_alone(pictures, found, config):
        return (
            "ambiguous",
            "land beyond the DEM may look like its horizon, and no two pictures alone are of the same mount",
        )
    if away > config.contradiction:
        return "contradicts_prior", f"the mount is {away:.1f} sigmas from where it is said to be"
    return "accepted", f"{len(pictures)} pictures agree"


def _told_alone(pictures: Sequence[MountPicture], found: Sequence[Pose], config: VerdictConfig) -> bool:
    """Whether two pictures or more are accepted by themselves, and all of these lie where the mount puts them."""
    apart = _alone_apart(pictures, found)
    return len(apart) > 1 and max(apart) <= config.mount_apart_deg


def _alone_apart(
    pictures: Sequence[MountPicture], found: Sequence[Pose], most_sigma_deg: float = math.inf
) -> list[float]:
    """Degrees of azimuth or pitch between where pictures are found by themselves and where the mount puts them, of
    those that are accepted and so sure."""
    return [
        float(np.degrees(np.abs(angles_between(pose, p.search.hypotheses[0].refined.pose)[:2]).max()))
        for p, pose in zip(pictures, found, strict=True)
        if p.search.verdict.word == "accepted" and max(p.search.verdict.sigma_deg) <= most_sigma_deg
    ]


def _gap_asked(pictures: Sequence[MountPicture], seen: SkylineFit, config: VerdictConfig) -> float:
    """Of a mount as of a picture (`pose_verdict.judge`): more where ridges alone tell."""
    evidences = [p.search.evidence for p in pictures]
    if any(evidence.skyline is not None for evidence in evidences):
        return config.gap_asked(seen.veiled, seen.variance)
    plants = float(np.median([evidence.plants for evidence in evidences]))
    return config.plants_gap if plants >= MANY_PLANTS else config.ridges_gap
