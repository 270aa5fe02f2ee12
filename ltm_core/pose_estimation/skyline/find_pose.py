"""Find a camera's pose in its image by matching the terrain's horizon and ridges with the photo's skyline and edges.

1. All azimuths within reach of the prior one are compared by the skyline (`skyline_search`) and by the ridges
   (`contour_scores`).
2. The best, a degree or more apart, are refined by least squares (`pose_refinement`).
3. The best of these is accepted where it stands out (`judge`). Where no skyline of the DEM is in the image, or
   land beyond the DEM may look like one, ridges alone are asked (`_asks_ridges`); and where the skyline by itself
   leaves the pose open, whether they are of the same one. Otherwise the prior pose stays.
4. Where land beyond the DEM may be the skyline, a pose among plants settles on the ridges (`settled_on_ridges`).

With an unknown lens, pose, focal length and k1 are found together; a wrong lens makes every pose ambiguous."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import vector_of_matrix
from ltm_core.pose_estimation.lens import LensPrior, RadialTrend, corner_radius, radial_trend
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections, PictureEvidence
from ltm_core.pose_estimation.skyline.picture_pose_config import BARE_EARTH, CrestCover, Criteria
from ltm_core.pose_estimation.skyline.pose_hypothesis import (
    Hypothesis,
    PoseVerdict,
    judge,
    mean_of_both,
    merged_with_others,
    search_reach,
)
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem, skyline_observations
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.pose_estimation.skyline.pose_refinement import RefinedPose, refine, settled_on_ridges, skyline_fit
from ltm_core.pose_estimation.skyline.pose_search import poses_on_skyline, search_ridges
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon, terrain_horizon
from ltm_core.raster.dem import Dem
from ltm_core.tracing.possible_ground import PossibleGround

_LEAST_SUPPORT = 0.3
"""Minimum share of the photo's skyline that must lie on the DEM's horizon, unless ridges alone agree. Above trees, and
if a good skyline leaves two poses open, ridges mislead more often than not."""

_SETTLING_PLANTS = 0.3  # minimum share of plants in the land for a pose to settle; nothing rises above bare ground
_SETTLED_SIGMA_DEG = 0.3  # maximum sigma of a settled azimuth; less certain poses keep that of skyline and ridges


@dataclass(frozen=True, eq=False)
class PictureSearch:
    """Hypotheses in order of cost, the evidence by which they were judged, and the verdict on the first."""

    hypotheses: tuple[Hypothesis, ...]
    evidence: PictureEvidence
    horizon: TerrainHorizon
    verdict: PoseVerdict

    @property
    def accepted(self) -> bool:
        return self.verdict.word == "accepted"

    def doubted(self, reason: str) -> "PictureSearch":
        """Return the result with a verdict that is not accepted."""
        return replace(self, verdict=replace(self.verdict, word="ambiguous", reason=reason)) if self.accepted else self


@dataclass(frozen=True, eq=False)
class SearchTerrain:
    """Terrain for the search: the DEM, the bend of rays over it, the maximum height of unknown ground, and the cover of
    crests over the DEM."""

    dem: Dem
    bend: float
    possible: PossibleGround = field(default_factory=PossibleGround)
    cover: CrestCover = BARE_EARTH

    def above(self, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Return the hypotheses whose camera is not under the ground."""
        places = np.array([h.refined.pose.position for h in hypotheses]).reshape(-1, 3)
        under = places[:, 2] <= self.dem.elevation_at(places[:, 0], places[:, 1])
        return [h for h, bad in zip(hypotheses, under, strict=True) if not bad]

    def horizon_for(self, camera: Camera, prior: PosePrior) -> TerrainHorizon:
        """Return the horizon from the prior position over the range of the search."""
        reach = search_reach(prior)
        half = math.radians(camera.hfov_deg) / 2 + reach + math.radians(8.0)
        pixel = math.atan(1 / camera.fx)
        step = max(math.radians(0.04), 0.6 * pixel) if half >= math.pi else max(math.radians(0.02), 0.5 * pixel)
        azimuth = math.radians(prior.pose.angles_deg[0])
        found = terrain_horizon(self.dem, prior.pose.position, self.bend, self.possible, azimuth, half, step)
        return replace(found, cover=self.cover)


def find_pose(
    evidence: PictureEvidence,
    terrain: SearchTerrain,
    prior: PosePrior,
    focal_sigma: float = 0.0,
    horizon: TerrainHorizon | None = None,
) -> PictureSearch:
    """Search the pose of an image and judge it. `focal_sigma`: relative; 0 holds it. `horizon`: if it is known already.
    Raises PoseError as `terrain_horizon`."""
    horizon = terrain.horizon_for(evidence.camera, prior) if horizon is None else horizon
    problem = PoseProblem(evidence, horizon, prior, focal_sigma)

    def judged(hypotheses: list[Hypothesis], by_ridges: bool, gap_by_ridges: float | None = None) -> PictureSearch:
        if hypotheses:  # a mean of poses has no fit of its own, and the search by ridges does not use the skyline
            best, *others = hypotheses
            fit = skyline_fit(best.refined.pose, best.refined.camera, problem)
            hypotheses = [replace(best, refined=replace(best.refined, skyline=fit)), *others]
        verdict = judge(hypotheses, by_ridges, prior, evidence.plants, gap_by_ridges)
        return PictureSearch(tuple(hypotheses), evidence, horizon, verdict)

    found: list[Hypothesis] = []
    if evidence.skyline is not None:
        found = terrain.above(poses_on_skyline(problem))
        # Of those above the ground alone: else what comes next would be as sure as if nothing were about it.
        found = terrain.above(merged_with_others(found))
    result = judged(found, False)
    if not found or _asks_ridges(result):
        by_ridges = terrain.above(search_ridges(problem))
        alone = judged(merged_with_others(by_ridges, by_ridges=True), True)
        both = mean_of_both(found[0], alone.hypotheses[0]) if found and by_ridges else None
        mean = terrain.above([both]) if both is not None else []
        together = judged([*mean, *found[1:]], False, alone.verdict.gap) if mean else None
        result = _decided(result, alone, together)
    settles = evidence.plants >= _SETTLING_PLANTS
    if settles and result.accepted and result.hypotheses[0].refined.skyline.open > Criteria.open_share:
        result = _settled(result, problem, terrain)
    trend = skyline_bending(result, problem)
    least = _BENT_SIGMAS[result.accepted]
    if trend is None or not least * trend.sigma < abs(trend.k) < _MOST_BENT / corner_radius(evidence.camera) ** 2:
        return result
    # How much cannot be said: a pose that is fitted with a wrong lens is itself off.
    bent = f"{result.verdict.reason}; its misfits bend with the radius, as by an unknown lens distortion"
    doubted = result.doubted(bent)
    return replace(doubted, verdict=replace(doubted.verdict, reason=bent))


_BENT_SIGMAS = {True: 4.0, False: 2.5}  # minimum trend in sigmas that rejects an accepted pose, or is named for another
_MOST_BENT = 0.6  # maximum radial shift at the image's corner, as a share of the radius, that is taken for a lens's


def skyline_bending(search: PictureSearch, problem: PoseProblem) -> RadialTrend | None:
    """Return the k1 by which the skyline's misfits at the best hypothesis bend; None without a skyline."""
    skyline = search.evidence.skyline
    if skyline is None or not search.hypotheses:
        return None
    best = search.hypotheses[0].refined
    camera = best.camera
    rows = skyline_observations(best.pose, camera, problem, 1.0)
    if rows is None:
        return None
    x, y = (skyline.u - camera.cx) / camera.fx, (skyline.v - camera.cy) / camera.fy
    bent = x * x + y * y
    steep = np.gradient(skyline.v, skyline.u)
    by_k = (camera.fy * y - steep * camera.fx * x) * bent
    kept = (rows.weight > 0) & (np.abs(rows.error) < 0.05 * camera.fy) & np.isfinite(by_k)
    if kept.sum() < 24:
        return None
    # Neighbouring columns err together: each counts by its weight only.
    sigma = rows.sigma[kept] / np.sqrt(rows.weight[kept])
    # The terrain lies lower than the photo's skyline by what the lens moved that up.
    return radial_trend(-rows.error[kept], rows.slopes[kept, 3:7], by_k[kept], sigma)


def _decided(by_skyline: PictureSearch, by_ridges: PictureSearch, together: PictureSearch | None) -> PictureSearch:
    """Return what counts of a pose by the skyline, one by ridges alone, and, if both agree, their mean."""
    if not by_skyline.hypotheses:
        return by_ridges
    best = by_skyline.hypotheses[0]
    seen = best.refined.skyline
    if seen.open <= Criteria.open_share and seen.support >= _LEAST_SUPPORT:  # it is the DEM's skyline
        if together is not None and together.hypotheses[0].refined.skyline.cost <= seen.cost + Criteria.agree_cost:
            return together
        reason = "it rests on a single ridge, and the other ridges do not confirm it"
        return by_skyline.doubted(reason) if by_ridges.hypotheses else by_skyline
    if by_skyline.accepted and by_ridges.hypotheses:
        apart = abs(float(angles_between(best.refined.pose, by_ridges.hypotheses[0].refined.pose)[0]))
        if apart <= math.radians(Criteria.open_apart_deg):
            return by_skyline
    for other in (by_ridges, together):
        if other is not None and other.accepted:
            return other
    return by_skyline.doubted("land beyond the DEM may resemble its horizon, and the ridges do not confirm the pose")


def _settled(found: PictureSearch, problem: PoseProblem, terrain: SearchTerrain) -> PictureSearch:
    """Return the pose of an open view settled on its ridges alone; `found` if they do not determine the azimuth."""
    best, *others = found.hypotheses
    refined = settled_on_ridges(best.refined, problem)
    kept = terrain.above([replace(best, refined=refined)])
    if not kept or refined.sigma_deg[0] > _SETTLED_SIGMA_DEG:
        return found
    return replace(found, hypotheses=(*kept, *others), verdict=replace(found.verdict, sigma_deg=refined.sigma_deg))


def _asks_ridges(by_skyline: PictureSearch) -> bool:
    """Return whether ridges alone are tried, too: where the skyline is not that of the DEM, or by itself leaves the
    pose open, where land beyond the DEM may look like it, and where one crest is all that the pose is by."""
    if not by_skyline.accepted:
        return True
    best, verdict = by_skyline.hypotheses[0], by_skyline.verdict
    if best.refined.skyline.open > Criteria.open_share:
        return not Criteria.open_gap <= verdict.gap < math.inf
    return best.ridge_score < Criteria.lone_score and verdict.sigma_deg[0] > Criteria.lone_sigma_deg


_K1_STEP, _K1_REACH = 0.5, 2.0  # step and reach of the search of k1, in its standard deviations
_HALVINGS, _FOLLOWED = 4, 4  # number of steps to the best k1, and of poses that are followed in each
_FOCAL_LEFT = 0.005  # relative standard deviation of the focal length once k1 is found


@dataclass(frozen=True, eq=False)
class _Trial:
    """A pose with its k1, and its cost with that of k1."""

    k1: float
    refined: RefinedPose
    cost: float


def find_pose_and_lens(
    evidence_of: Callable[[Camera], PictureEvidence],
    camera: Camera,
    terrain: SearchTerrain,
    prior: PosePrior,
    lens: LensPrior,
) -> tuple[PictureSearch, Camera]:
    """Search the pose, the focal length and k1 of an image; return the search and the image's camera with the lens.

    `evidence_of`: evidence in the image by its camera, which undistorts it. Every k1 within two standard deviations is
    searched on the skyline. The best pose is followed to the k1 of least cost. The pose is then searched with that
    lens; poses of other lenses widen it and are alternatives to it. Without a skyline, the lens stays as stated."""
    horizon = terrain.horizon_for(camera, prior)
    ridges = ContourDirections.of(horizon)
    middle = camera.distortion[0]

    def with_k1(k1: float) -> Camera:
        return replace(camera, distortion=(k1, *camera.distortion[1:]))

    def problem(evidence: PictureEvidence) -> PoseProblem:
        return PoseProblem(evidence, horizon, prior, lens.focal)

    def trial(k1: float, refined: RefinedPose) -> _Trial:
        return _Trial(k1, refined, refined.cost + 0.5 * ((k1 - middle) / lens.k1) ** 2)

    def followed(start: _Trial, k1: float) -> _Trial:
        evidence = evidence_of(with_k1(k1))
        pose, work = start.refined.pose, start.refined.camera
        around = ridges.in_view(pose, work)
        return trial(k1, refine(pose, work, problem(evidence), around))

    trials: list[_Trial] = []
    for step in np.arange(-_K1_REACH, _K1_REACH + _K1_STEP / 2, _K1_STEP):
        k1 = middle + float(step) * lens.k1
        evidence = evidence_of(with_k1(k1))
        if evidence.skyline is not None:
            found = terrain.above(poses_on_skyline(problem(evidence)))
            trials += [trial(k1, h.refined) for h in found]
    if not trials:
        return find_pose(evidence_of(camera), terrain, prior, lens.focal, horizon), camera
    # The best are followed to neighbouring k1: the grid of focal lengths finds each within its own errors.
    step = _K1_STEP * lens.k1
    for _ in range(_HALVINGS):
        step /= 2
        trials.sort(key=lambda t: t.cost)
        trials += [followed(t, t.k1 + sign * step) for t in trials[:_FOLLOWED] for sign in (-1.0, 1.0)]
    best = min(trials, key=lambda t: t.cost)
    evidence = evidence_of(with_k1(best.k1))
    zoom = best.refined.camera.fx / evidence.camera.fx
    evidence = replace(evidence, camera=evidence.camera.zoomed(zoom))
    search = find_pose(evidence, terrain, prior, _FOCAL_LEFT, horizon)
    return _with_other_lenses(search, trials, best), with_k1(best.k1).zoomed(zoom)


def _with_other_lenses(search: PictureSearch, trials: list[_Trial], best: _Trial) -> PictureSearch:
    """Return the search with the spread of the poses of other lenses in its covariance, and its verdict by it."""
    if not search.hypotheses:
        return search
    verdict = search.verdict
    first, *others = search.hypotheses
    variance = first.refined.skyline.variance
    weights: list[float] = []
    turns: list[Float64Array] = []
    for trial in sorted(trials, key=lambda t: t.cost):
        pose, gap = trial.refined.pose, trial.cost - best.cost
        if abs(float(angles_between(first.refined.pose, pose)[0])) <= math.radians(Criteria.alternative_deg):
            turn = vector_of_matrix(pose.rotation @ best.refined.pose.rotation.T)
            # Starts that ended in one place are one pose.
            if all(float(np.abs(turn - other).max()) > math.radians(Criteria.same_deg) for other in turns):
                weights.append(math.exp(-gap / (Criteria.agreement * variance)))
                turns.append(turn)
        elif verdict.word == "accepted" and gap < Criteria.gap_asked(first.refined.skyline.veiled, variance):
            reason = f"with a lens of k1 {trial.k1:+.2f}, azimuth {pose.angles_deg[0]:.1f} deg costs {gap:.1f} more"
            verdict = replace(verdict, word="ambiguous", reason=reason, gap=gap)
    covariance = first.refined.covariance.copy()
    if weights:
        away = np.array(turns)
        covariance[3:6, 3:6] += (away.T * np.array(weights)) @ away / sum(weights)
    refined = replace(first.refined, covariance=covariance)
    verdict = replace(verdict, sigma_deg=refined.sigma_deg)
    if verdict.word == "accepted" and max(refined.sigma_deg) > Criteria.most_sigma_deg:
        sigmas = ", ".join(f"{sigma:.2f}" for sigma in refined.sigma_deg)
        reason = f"other lenses fit as well: azimuth, pitch, roll are known only to {sigmas} deg"
        verdict = replace(verdict, word="ambiguous", reason=reason)
    return replace(search, hypotheses=(replace(first, refined=refined), *others), verdict=verdict)
