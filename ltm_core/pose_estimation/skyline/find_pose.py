"""Find a camera's pose in its photo, and decide whether it is accepted.

Finds a camera's pose in its picture: the terrain's horizon and ridges are laid on the photo's skyline and edges.

1. All azimuths within reach of the prior one are compared by the skyline (`skyline_search`) and by the ridges
   (`contour_scores`).
2. The best, a degree or more apart, are refined by least squares (`pose_refinement`).
3. The best of these is accepted where it stands out (`pose_verdict`). Where no skyline of the DEM is in the picture, or
   land beyond the DEM may look like one, ridges alone are asked (`ridge_search`); and where the skyline by itself
   leaves the pose open, whether they are of the same one. Otherwise the prior pose stays.
4. Where land beyond the DEM may be the skyline, a pose among plants settles on the ridges (`ridge_settling`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.pose_estimation.skyline.picture_evidence import PictureEvidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig, VerdictConfig
from ltm_core.pose_estimation.skyline.pose_hypothesis import (
    Hypothesis,
    PosePrior,
    angles_between,
    mean_of_both,
    merged_with_others,
    search_reach,
    widened_by_others,
)
from ltm_core.pose_estimation.skyline.pose_refinement import SkylineFit, settled_on_ridges, skyline_fit
from ltm_core.pose_estimation.skyline.pose_search import poses_on_skyline, search_ridges
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon, terrain_horizon
from ltm_core.raster.dem import Dem
from ltm_core.tracing.holes import PossibleGround

MANY_PLANTS = 0.5
"""Share of trees and shrubs in the land from which on edges are theirs as well as the ground's,"""
OVERGROWN = 0.85
"""and from which on hardly anything else is in the picture."""
Word = Literal["accepted", "ambiguous", "no_skyline", "contradicts_prior"]


@dataclass(frozen=True)
class Verdict:
    """`word`, and why in words. `gap`: by how much the best alternative costs more (inf: there is none);
    `alternative_deg`: its azimuth; `sigma_deg`: of azimuth, pitch, roll; `support`: share of the skyline that fits.
    """

    word: Word
    reason: str
    gap: float
    alternative_deg: float | None
    sigma_deg: tuple[float, float, float]
    support: float


def judge(
    hypotheses: Sequence[Hypothesis],
    by_ridges: bool,
    prior: PosePrior,
    config: PicturePoseConfig,
    plants: float,
    gap_by_ridges: float | None = None,
) -> Verdict:
    """Judge the first of `hypotheses`, from the best down; `by_ridges`: they were found without a skyline. `plants`:
    the share of trees and shrubs in the picture's land. `gap_by_ridges`: ridges alone are of the same pose, and
    alternatives cost so much more by them.
    """
    v = config.verdict
    nowhere = (math.inf, math.inf, math.inf)
    if not hypotheses:
        return Verdict(
            "no_skyline", "neither a skyline nor a ridge of the DEM is in the picture", 0.0, None, nowhere, 0.0
        )
    best = hypotheses[0]
    sigma = azimuth, pitch, roll = best.refined.sigma_deg
    gap, other = math.inf, None
    middle = best.about or best.refined.pose  # what is not part of a mean is an alternative to it
    for hypothesis in hypotheses[1:]:
        away = abs(float(angles_between(middle, hypothesis.refined.pose)[0]))
        if away > math.radians(v.alternative_deg):
            gap, other = hypothesis.cost - best.cost + (gap_by_ridges or 0.0), hypothesis.refined.pose.angles_deg[0]
            break
    support = best.refined.skyline.support

    def verdict(word: Word, reason: str) -> Verdict:
        return Verdict(word, reason, gap, other, sigma, support)

    close = by_ridges or (plants >= OVERGROWN and gap_by_ridges is None)
    most_azimuth = v.close_azimuth_sigma_deg if close else v.most_sigma_deg
    open_view = best.refined.skyline.open > v.open_share
    if open_view:
        most_azimuth = min(most_azimuth, v.open_azimuth_sigma_deg)
    if max(sigma) > v.most_sigma_deg or azimuth > most_azimuth:
        known = "what ridges are in the picture" if by_ridges else "the skyline"
        word: Word = "no_skyline" if by_ridges else "ambiguous"
        return verdict(word, f"{known} leaves azimuth, pitch, roll open by {azimuth:.2f}, {pitch:.2f}, {roll:.2f} deg")
    veiled, variance = best.refined.skyline.veiled, best.refined.skyline.variance
    least = v.gap_asked(veiled, variance)
    if by_ridges:
        least = v.plants_gap if plants >= MANY_PLANTS else v.ridges_gap
        if plants >= MANY_PLANTS and best.ridge_score < v.plants_score:
            return verdict("ambiguous", f"ridges lie on edges only {best.ridge_score:.1f} times more than by chance")
        if variance > v.ridges_variance:
            return verdict(
                "ambiguous", f"the photo's skyline speaks against it: its misfits' variance is {variance:.1f}"
            )
    elif variance > v.most_variance and (open_view or max(sigma) > v.sharp_sigma_deg):
        doubt = "may be of land beyond the DEM" if open_view else "leaves an angle unsure"
        return verdict("ambiguous", f"the skyline {doubt}, and its misfits' variance on the horizon is {variance:.1f}")
    if gap < least:
        hidden = f", and plants on near crests may hide {veiled:.0%} of the horizon"
        told = hidden if veiled > 0.03 and not by_ridges else ""
        return verdict("ambiguous", f"azimuth {other:.1f} deg costs only {gap:.1f} more{told}")
    asked = v.least_support if open_view else v.support_asked(max(sigma))
    if not by_ridges and support < (asked if gap_by_ridges is None else v.sharp_support):
        return verdict("ambiguous", f"only {support:.0%} of the photo's skyline lies on the terrain's")
    away_by = np.abs(prior.deviation(best.refined.pose)[3:]) / prior.sigmas[3:]
    if away_by.max() > v.contradiction:
        name = ("azimuth", "pitch", "roll")[int(away_by.argmax())]
        return verdict("contradicts_prior", f"the picture's {name} is {away_by.max():.1f} sigmas from the stated one")
    return verdict(
        "accepted", f"the next best azimuth costs {gap:.1f} more" if math.isfinite(gap) else "no alternative"
    )


_LEAST_SUPPORT = 0.3
"""Share of the photo's skyline that must lie on the DEM's; where less does, ridges may stand by themselves: above
trees, and where a good skyline leaves two poses open, they mislead more often than not."""


@dataclass(frozen=True, eq=False)
class PictureSearch:
    """Hypotheses from the best down, and what they were judged by."""

    hypotheses: tuple[Hypothesis, ...]
    evidence: PictureEvidence
    horizon: TerrainHorizon
    verdict: Verdict


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground for the search: the DEM, the bend of rays over it, and how high ground may be that it does not know."""

    dem: Dem
    bend: float
    possible: PossibleGround = field(default_factory=PossibleGround)

    def above(self, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Without those whose camera a free place has brought under the ground."""
        places = np.array([h.refined.pose.position for h in hypotheses]).reshape(-1, 3)
        under = places[:, 2] <= self.dem.elevation_at(places[:, 0], places[:, 1])
        return [h for h, bad in zip(hypotheses, under, strict=True) if not bad]

    def horizon_for(self, camera: Camera, prior: PosePrior, config: PicturePoseConfig) -> TerrainHorizon:
        """Seen from the prior position, as far round as the search may look."""
        reach = search_reach(prior, config)
        half = math.radians(camera.hfov_deg) / 2 + reach + math.radians(8.0)
        pixel = math.atan(1 / camera.fx)
        step = max(math.radians(0.04), 0.6 * pixel) if half >= math.pi else max(math.radians(0.02), 0.5 * pixel)
        azimuth = math.radians(prior.pose.angles_deg[0])
        return terrain_horizon(self.dem, prior.pose.position, self.bend, self.possible, azimuth, half, step)


def find_pose(
    evidence: PictureEvidence,
    terrain: Terrain,
    prior: PosePrior,
    config: PicturePoseConfig = PicturePoseConfig(),
    focal_sigma: float = 0.0,
    horizon: TerrainHorizon | None = None,
) -> PictureSearch:
    """Search the pose of a picture and judge it.

    `focal_sigma`: of the focal length, relative; 0 holds it. `horizon`: of the prior position, where it is known
    already. Raises PoseError as `terrain_horizon`.
    """
    horizon = terrain.horizon_for(evidence.camera, prior, config) if horizon is None else horizon

    def judged(hypotheses: list[Hypothesis], by_ridges: bool, gap_by_ridges: float | None = None) -> _Judged:
        hypotheses = _on_skyline(hypotheses, evidence, horizon, config)
        return _Judged(hypotheses, judge(hypotheses, by_ridges, prior, config, evidence.plants, gap_by_ridges))

    found: list[Hypothesis] = []
    if evidence.skyline is not None:
        found = terrain.above(poses_on_skyline(evidence, horizon, prior, config, focal_sigma))
        # Of those above the ground alone: else what comes next would be as sure as if nothing were about it.
        found = terrain.above(merged_with_others(found, config.verdict))
    result = judged(found, False)
    if not found or _asks_ridges(result, config.verdict):
        unseen = replace(evidence, skyline=None)
        by_ridges = terrain.above(search_ridges(unseen, horizon, prior, config, focal_sigma))
        alone = judged(widened_by_others(by_ridges, config.verdict), True)
        both = mean_of_both(found[0], alone.hypotheses[0], config.verdict) if found and by_ridges else None
        mean = terrain.above([both]) if both is not None else []
        together = judged([*mean, *found[1:]], False, alone.verdict.gap) if mean else None
        result = _decided(result, alone, together, config.verdict)
    settles = evidence.plants >= config.settling.least_plants
    if settles and result.accepted and result.hypotheses[0].refined.skyline.open > config.verdict.open_share:
        result = _settled(result, evidence, terrain, horizon, prior, config, focal_sigma)
    return PictureSearch(tuple(result.hypotheses), evidence, horizon, result.verdict)


@dataclass(frozen=True, eq=False)
class _Judged:
    """Hypotheses from the best down, and the verdict on the first."""

    hypotheses: list[Hypothesis]
    verdict: Verdict

    @property
    def accepted(self) -> bool:
        return self.verdict.word == "accepted"

    def doubted(self, reason: str) -> _Judged:
        """The same, not accepted."""
        if not self.accepted:
            return self
        return replace(self, verdict=replace(self.verdict, word="ambiguous", reason=reason))


def _decided(by_skyline: _Judged, by_ridges: _Judged, together: _Judged | None, config: VerdictConfig) -> _Judged:
    """What counts of a pose by the skyline, one by ridges alone, and their mean, where both may be of one pose."""
    if not by_skyline.hypotheses:
        return by_ridges
    seen = by_skyline.hypotheses[0].refined.skyline
    if not _may_mislead(seen, config):
        if together is not None and together.hypotheses[0].refined.skyline.cost <= seen.cost + config.agree_cost:
            return together
        reason = "it hangs on hardly more than one crest, and ridges alone do not lie there"
        return by_skyline.doubted(reason) if by_ridges.hypotheses else by_skyline
    if by_skyline.accepted and _agree(by_skyline.hypotheses[0], by_ridges.hypotheses, config):
        return by_skyline
    for other in (by_ridges, together):
        if other is not None and other.accepted:
            return other
    return by_skyline.doubted("land beyond the DEM may look like its horizon, and ridges alone do not lie there")


def _settled(
    found: _Judged,
    evidence: PictureEvidence,
    terrain: Terrain,
    horizon: TerrainHorizon,
    prior: PosePrior,
    config: PicturePoseConfig,
    focal_sigma: float,
) -> _Judged:
    """An open view's pose settled on its ridges alone, whose errors go together by what grows there; as it was where
    ridges leave it open."""
    best, *others = found.hypotheses
    refined = settled_on_ridges(best.refined, evidence, horizon, prior, focal_sigma, config)
    kept = terrain.above([replace(best, refined=refined)])
    if not kept or refined.sigma_deg[0] > config.settling.most_azimuth_sigma_deg:
        return found
    return _Judged([*kept, *others], replace(found.verdict, sigma_deg=refined.sigma_deg))


def _asks_ridges(by_skyline: _Judged, config: VerdictConfig) -> bool:
    """Whether ridges alone are tried, too: where the skyline is not that of the DEM, or by itself leaves the pose open,
    where land beyond the DEM may look like it, and where one crest is all that the pose is by."""
    if not by_skyline.accepted:
        return True
    best, verdict = by_skyline.hypotheses[0], by_skyline.verdict
    if best.refined.skyline.open > config.open_share:
        return not config.open_gap <= verdict.gap < math.inf
    return best.ridge_score < config.lone_score and verdict.sigma_deg[0] > config.lone_sigma_deg


def _may_mislead(skyline: SkylineFit, config: VerdictConfig) -> bool:
    """Whether what is seen may not be the DEM's skyline at all: then ridges may stand by themselves."""
    return skyline.open > config.open_share or skyline.support < _LEAST_SUPPORT


def _agree(best: Hypothesis, by_ridges: list[Hypothesis], config: VerdictConfig) -> bool:
    """Whether ridges alone are of the same azimuth."""
    if not by_ridges:
        return False
    apart = float(angles_between(best.refined.pose, by_ridges[0].refined.pose)[0])
    return abs(apart) <= math.radians(config.open_apart_deg)


def _on_skyline(
    hypotheses: list[Hypothesis], evidence: PictureEvidence, horizon: TerrainHorizon, config: PicturePoseConfig
) -> list[Hypothesis]:
    """The same, the first one with how the photo's skyline lies there: a mean lies where none of those fits that it is
    of, and ridges are sought without a skyline."""
    if not hypotheses:
        return hypotheses
    best, *others = hypotheses
    fit = skyline_fit(best.refined.pose, best.refined.camera, evidence, horizon, config)
    return [replace(best, refined=replace(best.refined, skyline=fit)), *others]
