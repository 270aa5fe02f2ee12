"""Scores traced, network and fused depth against truth, with exact poses and with poses wrong by known angles."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.topodepth import FusedDepth, fuse
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.scoring.labels import DepthScore, DepthTally, at_pixels_of
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround
from ltm_core.vision.manifest import DepthKind
from ltm_lab.frames.truth_frames_io import TruthFrame

BEYOND = "beyond 100 m"
"""The group of pixels for which the paper compares networks."""
_OPEN = 0.005  # relative: closer to bare ground than this (and 0.5 m) nothing stands before it


@dataclass(frozen=True)
class SourceScore:
    """Scores of one source of depth for one group of pixels, by range bin and then over all."""

    source: str
    group: str
    scores: list[DepthScore]


@dataclass(frozen=True)
class DepthEvaluationScore:
    """All sources with poses wrong by `pose_error_deg`, on the pixels for which every source has a depth.

    `verdicts`: frames by verdict. `checked`: frames with enough far ridges to detect a wrong pose. `beyond`: share of
    the fused depths that are off by more than three of their standard deviations. `coverage`: share of the pixels of
    finite true depth that each source covers."""

    pose_error_deg: float
    frames: int
    verdicts: Mapping[str, int]
    checked: int
    inlier_ratio: float
    beyond: float
    coverage: Mapping[str, float]
    rows: list[SourceScore]

    def rmse(self, source: str, group: str = "all", bin_index: int = -1) -> float:
        """RMSE of a source, metres; NaN where nothing was scored."""
        score = self._of(source, group, bin_index)
        return float("nan") if score is None else score.rmse

    def median(self, source: str, group: str = "all", bin_index: int = -1) -> float:
        """Median absolute error of a source, metres; NaN where nothing was scored."""
        score = self._of(source, group, bin_index)
        return float("nan") if score is None else score.median

    def _of(self, source: str, group: str, bin_index: int) -> DepthScore | None:
        found = (row.scores[bin_index] for row in self.rows if (row.source, row.group) == (source, group))
        return next(found, None)


@dataclass(frozen=True, eq=False)
class Given:
    """What a frame is evaluated with: a network's depth of the photo as seen, and labels of every pixel or None."""

    network: NetworkDepth
    labels: UInt8Array | None


class DepthEvaluation:
    """Scores frames whose poses are turned by `pose_error_deg` into a random direction.

    With a `surface` raster of earlier vegetation, its own traced depth is scored too, and fusion gets it. `possible`:
    ground beyond the DEM; rendered worlds have none."""

    def __init__(
        self,
        pose_error_deg: float,
        dem: Dem,
        classes: ClassPriors,
        bend_curvature: bool = True,
        surface: Dem | None = None,
        config: FusionConfig | None = None,
        possible: PossibleGround = NOTHING_BEYOND,
    ) -> None:
        if pose_error_deg < 0:
            raise ConfigError(f"a pose error of {pose_error_deg:g} degrees is negative; give 0 or more")
        self.pose_error_deg = pose_error_deg
        self._config = FusionConfig() if config is None else config
        self._classes = classes
        self._tracer = TerrainTracer(dem, bend_curvature, possible=possible)
        self._over = None if surface is None else TerrainTracer(surface, bend_curvature, possible=possible)
        self._tallies: dict[tuple[str, str], DepthTally] = {}
        self._verdicts: Counter[str] = Counter()
        self._checked = 0
        self._inliers: list[float] = []
        self._covered = Counter[str]()
        self._true = 0
        self._told = self._beyond = 0

    def add(self, frame: TruthFrame, given: Given) -> dict[str, Float32Array]:
        """Score one frame; return the depth of every source at the truth's pixels."""
        rng = np.random.default_rng(frame.stamp_ns % 2**32 + 1)
        pose = _turned(frame.pose, self.pose_error_deg, rng)
        traced = self._tracer.trace(frame.camera, pose)
        settings = FusionSettings()
        over = None if self._over is None else self._over.trace(frame.camera, pose)
        fused = fuse(traced, given.network, frame.photo, given.labels, self._classes, settings, over, self._config)
        size, shape = (frame.camera.height, frame.camera.width), frame.surface.shape
        own = at_pixels_of(given.network.values, size, shape)
        aligned = fit_to_truth(own, frame.surface, given.network.kind)
        sources = {
            "traced": at_pixels_of(fused.ground, size, shape),
            **({} if over is None else {"surface": at_pixels_of(over.depth(), size, shape)}),
            **({"metric": own} if given.network.kind == "metric" else {}),
            "aligned": aligned,
            "network": _fitted_to_terrain(fused, frame, size, aligned),
            "fused": at_pixels_of(fused.depth, size, shape),
        }
        true = np.isfinite(frame.surface)
        common = true & np.logical_and.reduce([np.isfinite(source) for source in sources.values()])
        with np.errstate(invalid="ignore"):
            before = frame.ground - frame.surface
        covered = before > np.maximum(_OPEN * frame.surface, 0.5)
        groups = {
            "all": common,
            "open": common & ~covered & ~frame.changed,
            "covered": common & covered,
            "changed": common & frame.changed,
            "covered or changed": common & (covered | frame.changed),
            BEYOND: common & (frame.surface > 100.0),
        }
        for name, depth in sources.items():
            self._covered[name] += int((true & np.isfinite(depth)).sum())
            for group, pixels in groups.items():
                tally = self._tallies.setdefault((name, group), DepthTally())
                tally.add(depth, np.where(pixels, frame.surface, np.nan).astype(np.float32))
        sigma = at_pixels_of(fused.sigma, size, shape)
        told = common & np.isfinite(sigma)
        self._told += int(told.sum())
        self._beyond += int((np.abs(sources["fused"][told] - frame.surface[told]) > 3 * sigma[told]).sum())
        self._true += int(true.sum())
        self._verdicts[fused.verdict.value] += 1
        self._checked += fused.pose.checked
        self._inliers.append(fused.inlier_ratio)
        return sources

    def score(self) -> DepthEvaluationScore:
        rows = [
            SourceScore(source, group, scores)
            for (source, group), tally in self._tallies.items()
            if (scores := tally.scores())[-1].pixels
        ]
        coverage = {name: count / max(self._true, 1) for name, count in self._covered.items()}
        frames = sum(self._verdicts.values())
        inliers = float(np.mean(self._inliers)) if self._inliers else float("nan")
        beyond = self._beyond / max(self._told, 1)
        return DepthEvaluationScore(
            self.pose_error_deg, frames, dict(self._verdicts), self._checked, inliers, beyond, coverage, rows
        )


def _turned(pose: Pose, error_deg: float, rng: np.random.Generator) -> Pose:
    """Return a pose whose viewing direction is wrong by `error_deg`."""
    azimuth, pitch, roll = pose.angles_deg
    angle = rng.uniform(0, 2 * np.pi)
    across, up = error_deg * np.cos(angle), error_deg * np.sin(angle)
    return Pose.from_angles(pose.position, azimuth + float(across), pitch + float(up), roll)


def upsampled_labels(labels: UInt8Array, size: tuple[int, int]) -> UInt8Array:
    """Sampled true labels (h, w) for every pixel of a photo of `size`, nearest."""
    step = round(size[1] / labels.shape[1])
    return np.ascontiguousarray(np.repeat(np.repeat(labels, step, 0), step, 1)[: size[0], : size[1]])


def _fitted_to_terrain(
    fused: FusedDepth, frame: TruthFrame, size: tuple[int, int], otherwise: Float32Array
) -> Float32Array:
    """The network's metres at the truth's pixels: fitted to the terrain, and `otherwise` where that failed."""
    if fused.fit is None or fused.fit.trouble:
        return otherwise
    inverse = at_pixels_of(fused.fit.inverse, size, frame.surface.shape)
    farthest = float(np.max(frame.surface[np.isfinite(frame.surface)], initial=1.0))
    return np.asarray(1.0 / np.maximum(inverse, 1.0 / farthest), np.float32)


def fit_to_truth(values: Float32Array, truth: Float32Array, kind: DepthKind) -> Float32Array:
    """`values` (H, W) as metres: scale and shift by least squares over the pixels of finite truth; of metric depth the
    scale alone, the median ratio.

    The protocol by which networks of relative depth are compared (Ranftl et al. 2020, "Towards robust monocular depth
    estimation", section 6): inverse depth is fitted in inverse depth, and the result is held below the largest true
    depth. Raises ImageError on different shapes."""
    if values.shape != truth.shape:
        raise ImageError(f"depth of {values.shape} cannot be fitted to truth of {truth.shape}")
    both = np.isfinite(values) & np.isfinite(truth) & (truth > 0)
    if both.sum() < 2:
        return values
    inverse = kind == "relative_inverse"
    x, y = values[both].astype(np.float64), truth[both].astype(np.float64)
    if kind == "metric":
        positive = x > 0
        return np.asarray(values * np.median(y[positive] / x[positive]), np.float32) if positive.any() else values
    scale, shift = np.linalg.lstsq(np.column_stack([x, np.ones_like(x)]), 1 / y if inverse else y, rcond=None)[0]
    fitted = scale * values.astype(np.float64) + shift
    farthest = y.max()
    if inverse:
        fitted = 1 / np.maximum(fitted, 1 / farthest)
    return np.asarray(np.clip(fitted, 0, farthest), np.float32)
