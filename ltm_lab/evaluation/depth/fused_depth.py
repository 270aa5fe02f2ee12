"""Scores traced, network and fused depth against truth, under known errors of pose, terrain and view.

The errors are applied on purpose (see `Condition`). `ltm-lab eval depth` prints the scores.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.topodepth import FusedDepth, fuse
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.holes import NOTHING_BEYOND, PossibleGround
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.depth.ablation import without
from ltm_lab.evaluation.metrics.depth import DepthScore
from ltm_lab.evaluation.metrics.depth_fit import at_pixels_of, fit_to_truth
from ltm_lab.evaluation.metrics.depth_tally import DepthTally
from ltm_lab.evaluation.truth_frames_io import TruthFrame

_OPEN = 0.005  # relative: closer to bare ground than this (and 0.5 m) nothing stands before it


@dataclass(frozen=True)
class Condition:
    """What is done to a frame before it is fused. `pose_error_deg`: turn of the camera in a random direction, and so
    is `shift`, metres, of the DEM. `coarsen`: cells of the DEM, metres. `occluded`: share of the photo behind things
    that stand before the camera. `without`: a stage of fusion that is left out (`ablation.STAGES`).
    """

    pose_error_deg: float = 0.0
    occluded: float = 0.0
    coarsen: float = 0.0
    shift: float = 0.0
    without: str = ""

    def __post_init__(self) -> None:
        if not (0 <= self.occluded < 0.9 and min(self.pose_error_deg, self.coarsen, self.shift) >= 0):
            raise ConfigError(f"{self}: errors are 0 or more, and at most 0.9 of a photo may be occluded")

    @property
    def name(self) -> str:
        parts = [
            f"pose {self.pose_error_deg:g} deg" if self.pose_error_deg else "",
            f"{self.occluded:.0%} occluded" if self.occluded else "",
            f"DEM of {self.coarsen:g} m" if self.coarsen else "",
            f"DEM shifted {self.shift:g} m" if self.shift else "",
            f"without {self.without}" if self.without else "",
        ]
        return ", ".join(part for part in parts if part) or "exact"

    def dem(self, dem: Dem) -> Dem:
        """The DEM of this condition."""
        geometry, elevation = dem.geometry, dem.elevation
        if self.coarsen:
            n = max(1, round(self.coarsen / geometry.resolution))
            rows, cols = geometry.height // n, geometry.width // n
            blocks = elevation[: rows * n, : cols * n].reshape(rows, n, cols, n)
            elevation = blocks.mean(axis=(1, 3)).astype(np.float32)
            geometry = GridGeometry(geometry.x_min, geometry.y_max, geometry.resolution * n, cols, rows, geometry.crs)
        return Dem(elevation, geometry.translated(self.shift * 0.8, -self.shift * 0.6))

    def pose(self, pose: Pose, rng: np.random.Generator) -> Pose:
        """A pose wrong by `pose_error_deg`."""
        azimuth, pitch, roll = pose.angles_deg
        angle = rng.uniform(0, 2 * np.pi)
        across, up = self.pose_error_deg * np.cos(angle), self.pose_error_deg * np.sin(angle)
        return Pose.from_angles(pose.position, azimuth + float(across), pitch + float(up), roll)

    def photo(self, photo: UInt8Array, rng: np.random.Generator) -> tuple[UInt8Array, BoolArray]:
        """The photo with dark leafy discs over `occluded` of it, and where they are, (H, W)."""
        hidden = np.zeros(photo.shape[:2], np.uint8)
        height, width = photo.shape[0], photo.shape[1]
        while hidden.mean() < self.occluded:
            centre = int(rng.uniform(0, width)), int(rng.uniform(0, height))
            cv2.circle(hidden, centre, int(height * rng.uniform(0.04, 0.14)), 1, -1)
        if not hidden.any():
            return photo, hidden.astype(np.bool_)
        leaves = rng.normal(45, 18, (*hidden.shape, 1)) * np.array([0.8, 1.0, 0.5])
        seen = np.where(hidden[..., None] > 0, np.clip(leaves, 0, 255), photo).astype(np.uint8)
        return seen, hidden.astype(np.bool_)


@dataclass(frozen=True)
class SourceScore:
    """Scores of one source of depth for one group of pixels, by range bin and then over all."""

    source: str
    group: str
    scores: list[DepthScore]


@dataclass(frozen=True)
class ConditionScore:
    """All sources under one condition, on the same pixels: those where every source has a depth. `verdicts`: frames by
    verdict. `checked`: frames with enough far crests to tell a wrong pose by. `beyond`: share of the fused depths that
    are off by more than three of their sigmas. `coverage`: share of the pixels of true
    finite depth that traced and fused depth cover.
    """

    condition: Condition
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
    """What a frame is evaluated with: a network's depth of the photo as seen, labels of every pixel or None, and in how
    many columns these were made (0: one for each of the photo)."""

    network: NetworkDepth
    labels: UInt8Array | None
    label_columns: int = 0


class DepthEvaluation:
    """Scores frames under one condition; `dem` is as given. With a `surface` raster, of what once stood there, its own
    traced depth is scored too, and fusion gets it. `possible`: ground beyond the DEM; rendered worlds have none."""

    def __init__(
        self,
        condition: Condition,
        dem: Dem,
        classes: ClassPriors,
        bend_curvature: bool = True,
        surface: Dem | None = None,
        config: FusionConfig | None = None,
        possible: PossibleGround = NOTHING_BEYOND,
    ) -> None:
        self.condition = condition
        self._config = FusionConfig() if config is None else config
        if condition.without:
            self._config = without(self._config, condition.without)
            classes = ClassPriors.of(LabelSet.load(), self._config)
        self._classes = classes
        self._tracer = TerrainTracer(condition.dem(dem), bend_curvature, possible=possible)
        self._over = None
        if surface is not None:
            self._over = TerrainTracer(condition.dem(surface), bend_curvature, possible=possible)
        self._tallies: dict[tuple[str, str], DepthTally] = {}
        self._verdicts: Counter[str] = Counter()
        self._checked = 0
        self._inliers: list[float] = []
        self._covered = Counter[str]()
        self._true = 0
        self._told = self._beyond = 0

    def seen(self, frame: TruthFrame) -> tuple[UInt8Array, BoolArray]:
        """The photo that networks get of a frame under this condition, and which pixels of it are hidden."""
        return self.condition.photo(frame.photo, np.random.default_rng(frame.stamp_ns % 2**32))

    def add(
        self, frame: TruthFrame, photo: UInt8Array, hidden: BoolArray, given: Given
    ) -> tuple[FusedDepth, dict[str, Float32Array]]:
        """Score one frame; its fused depth, and every source at the truth's pixels."""
        rng = np.random.default_rng(frame.stamp_ns % 2**32 + 1)
        pose = self.condition.pose(frame.pose, rng)
        traced = self._tracer.trace(frame.camera, pose)
        settings = FusionSettings(label_columns=given.label_columns)
        over = None if self._over is None else self._over.trace(frame.camera, pose)
        fused = fuse(traced, given.network, photo, given.labels, self._classes, settings, over, self._config)
        size, shape = (frame.camera.height, frame.camera.width), frame.surface.shape
        sources = {
            "traced": at_pixels_of(fused.ground, size, shape),
            **({} if over is None else {"surface": at_pixels_of(over.depth(), size, shape)}),
            "network": _network_alone(fused, given.network, frame, size),
            "fused": at_pixels_of(fused.depth, size, shape),
        }
        true = np.isfinite(frame.surface) & ~at_pixels_of(hidden, size, shape)
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
        return fused, sources

    def score(self) -> ConditionScore:
        rows = [
            SourceScore(source, group, tally.scores())
            for (source, group), tally in self._tallies.items()
            if tally.scores()[-1].pixels
        ]
        coverage = {name: count / max(self._true, 1) for name, count in self._covered.items()}
        frames = sum(self._verdicts.values())
        inliers = float(np.mean(self._inliers)) if self._inliers else float("nan")
        beyond = self._beyond / max(self._told, 1)
        return ConditionScore(
            self.condition, frames, dict(self._verdicts), self._checked, inliers, beyond, coverage, rows
        )


def upsampled_labels(labels: UInt8Array, size: tuple[int, int]) -> UInt8Array:
    """Sampled true labels (h, w) for every pixel of a photo of `size`, nearest."""
    step = round(size[1] / labels.shape[1])
    return np.ascontiguousarray(np.repeat(np.repeat(labels, step, 0), step, 1)[: size[0], : size[1]])


def _network_alone(fused: FusedDepth, network: NetworkDepth, frame: TruthFrame, size: tuple[int, int]) -> Float32Array:
    """The network's metres at the truth's pixels: fitted to the terrain, and where that failed to the truth itself."""
    shape = frame.surface.shape
    if fused.fit is None or fused.fit.trouble:
        return fit_to_truth(at_pixels_of(network.values, size, shape), frame.surface, network.kind)
    inverse = at_pixels_of(fused.fit.inverse, size, shape)
    farthest = float(np.max(frame.surface[np.isfinite(frame.surface)], initial=1.0))
    return np.asarray(1.0 / np.maximum(inverse, 1.0 / farthest), np.float32)


def conditions(
    pose_errors: Iterable[float] = (),
    occlusions: Iterable[float] = (),
    coarsen: Iterable[float] = (),
    shifts: Iterable[float] = (),
    stages: Iterable[str] = (),
) -> list[Condition]:
    """The exact condition and each error by itself."""
    exact = Condition()
    return [
        exact,
        *(replace(exact, pose_error_deg=value) for value in pose_errors if value),
        *(replace(exact, occluded=value) for value in occlusions if value),
        *(replace(exact, coarsen=value) for value in coarsen if value),
        *(replace(exact, shift=value) for value in shifts if value),
        *(replace(exact, without=stage) for stage in stages),
    ]
