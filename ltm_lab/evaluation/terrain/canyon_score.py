"""Scores the changes that the surface map finds from one real camera against later surveys of the site."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from ltm_core.base.types import BoolArray
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import fuse
from ltm_core.raster.dem import Dem
from ltm_core.scoring.labels import at_pixels_of
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.layers import SurfaceLayers
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.metrics.change import ChangeScore, score_change
from ltm_lab.evaluation.metrics.heights import SurfaceScore, score_surface
from ltm_lab.evaluation.terrain.canyon_io import PHOTOS, Canyon

BEFORE, AFTER = "121004", "150924"
STEP = 2
"""Factor by which the photos are reduced."""
RULES = TerrainConfig(threshold=0.5, columns=1000, max_range=600.0, min_area=10.0, register_frames=False)
OF_SURVEYS = RULES.model_copy(update={"repeated_error_share": 0.0, "alone": RULES.confidence})
"""Noise that is new each time, and has no heavy tails."""
_SECOND = 1_000_000_000


@dataclass(frozen=True, eq=False)
class CanyonScore:
    """`change`: of the cells that three dates have seen, against the last survey. `before`, `after`: heights against it
    there. `measured`: depth against that traced on each date's own survey, median absolute share; `verdicts`: of the
    fusion."""

    name: str
    change: ChangeScore
    before: SurfaceScore
    after: SurfaceScore
    estimate: SurfaceScore
    measured: float
    verdicts: tuple[str, ...]
    layers: SurfaceLayers
    truth: BoolArray


def score_canyon(canyon: Canyon, network: DepthNetwork | None) -> CanyonScore:
    """Start from the survey of BEFORE and look at the photos of three later dates.

    `network`: its depth of the photos, fitted to BEFORE's terrain, with the resected pose and its covariance; None:
    depth that is traced on each date's own survey, 0.3 m + 0.5 % of noise, with the pose as if it were exact: what the
    geometry would allow."""
    bar = canyon.surveys[BEFORE]
    # Sand carries no canopy: the survey is the surface.
    reference = Reference.of(bar, Dem(bar.elevation.copy(), bar.geometry))
    surface = SurfaceMap(reference, OF_SURVEYS if network is None else RULES, ("canyon",))
    errors: list[float] = []
    verdicts: list[str] = []
    for frame, share, verdict in _frames(canyon, network):
        surface.add(frame)
        errors.append(share)
        verdicts.append(verdict)
    surface.decide()
    layers = surface.layers()
    now, was = canyon.surveys[AFTER].elevation, canyon.surveys[BEFORE].elevation
    known = layers.observed & np.isfinite(now) & np.isfinite(was)
    truth = np.nan_to_num(np.abs(now - was)) >= RULES.threshold
    return CanyonScore(
        "network" if network is not None else "ideal depth",
        score_change(layers.change > 0, truth, known),
        score_surface(was, now, known & truth),
        score_surface(layers.height, now, known & truth),
        score_surface(layers.estimate, now, known),
        float(np.median(errors)),
        tuple(verdicts),
        layers,
        truth,
    )


def _frames(canyon: Canyon, network: DepthNetwork | None) -> Iterator[tuple[DepthFrame, float, str]]:
    rng = np.random.default_rng(22)
    camera, pose = canyon.resection.camera.scaled(STEP), canyon.resection.pose
    tracer = TerrainTracer(canyon.surveys[BEFORE])
    for date in PHOTOS:
        stamp = int(datetime.strptime(date, "%y%m%d").replace(tzinfo=UTC).timestamp()) * _SECOND
        true = TerrainTracer(canyon.surveys[date]).trace(camera, pose).depth()
        if network is None:
            sigma = (0.3 + 0.005 * np.where(np.isfinite(true), true, 0)).astype(np.float32)
            depth = (true + sigma * rng.standard_normal(true.shape)).astype(np.float32)
            verdict, covariance = "", np.diag([1e-6] * 3 + [1e-12] * 3)
        else:
            rgb = canyon.photo(date, STEP)
            covariance = canyon.resection.pose_covariance
            classes = ClassPriors.of(LabelSet.load(), network.fusion)
            angle = float(np.sqrt(np.diag(covariance)[3:].max()))
            given = tracer.trace(camera, pose), network.predict(rgb, camera), rgb, None
            fused = fuse(*given, classes, FusionSettings(angle, 0.1), config=network.fusion)
            seen = fused.measured()
            depth, sigma, verdict = seen.depth, seen.sigma, fused.verdict.value
        seen_at = at_pixels_of(depth, true.shape, true.shape)
        both = np.isfinite(seen_at) & np.isfinite(true)
        share = float(np.median(np.abs(seen_at[both] / true[both] - 1))) if both.any() else float("nan")
        yield DepthFrame.of_photo(depth, sigma, camera, pose, stamp, "canyon", covariance), share, verdict
