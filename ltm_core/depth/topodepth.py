"""TopoDepth: fuse traced depth and a network's depth of one photo, pixel by pixel, by their uncertainty.

After the paper's pixel sampling and RANSAC regression (the LTM paper, after FireLoc): the network's free scale comes
from pixels whose terrain can be trusted. The terrain's answer is brought to the visible surface, by the height of what
the labels say grows there or by a canopy raster, and at silhouettes by the photo. Then `pixel_fusion` decides."""

from dataclasses import asdict, dataclass, field
from enum import IntEnum, StrEnum
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.depth.expected_surface import FusionSettings, fitted
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.guided_upsampling import NetworkView
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.network_measurement import NetworkMeasurement, measured
from ltm_core.depth.occlusion_boundaries import refine_occlusion_boundaries
from ltm_core.depth.occlusion_prior import OcclusionPrior
from ltm_core.depth.pixel_fusion import fuse_pixels
from ltm_core.depth.pose_check import PoseCheck, check_pose
from ltm_core.depth.scale_fit import ScaleFit
from ltm_core.depth.unseen_terrain import (
    clear_unenclosed,
    hidden_at,
    mostly_unknown,
    with_labelled_sky,
)
from ltm_core.geometry.range_image import DepthImage, RangeImage
from ltm_core.vision.labels import UNLABELLED


class DepthSource(IntEnum):
    """Source of a pixel's depth: the values of `FusedDepth.source`."""

    UNKNOWN = 0
    TERRAIN = 1
    NETWORK = 2
    BOTH = 3
    SKY = 4


class FusionVerdict(StrEnum):
    """Verdict on the reliability of an image's fused depth."""

    OK = "ok"
    POSE_SUSPECTED = "pose_suspected"
    """The terrain does not match the photo: traced depth is returned unchanged, and nothing is fused."""
    NETWORK_UNUSABLE = "network_unusable"
    """The network's depth does not fit the terrain: only terrain depth is used, refined by the photo and labels."""
    NO_TERRAIN = "no_terrain"
    """No pixel was traced to known ground."""
    MOSTLY_UNKNOWN = "mostly_unknown"
    """As ok, but most of the photo is unknown: the terrain explains too little of it."""
    PICTURE_UNUSABLE = "picture_unusable"
    """The photo shows too little of the landscape (night or fog): traced depth is returned unchanged, and nothing is
    fused."""


@dataclass(frozen=True, eq=False)
class FusionOutcome:
    """Result of fitting one photo's network depth to the terrain: `verdict`, and its `reason` unless ok; `pose`; `fit`
    to trusted ground, None without one; `config`; `hidden`: (H, W) bool, without depth because structures hide the
    terrain, None: nowhere."""

    verdict: FusionVerdict
    reason: str
    pose: PoseCheck
    fit: ScaleFit | None = field(repr=False)
    config: FusionConfig = field(repr=False)
    hidden: BoolArray | None = field(repr=False)

    @property
    def inlier_ratio(self) -> float:
        """Return the share of trusted ground that fits the network's line; 0 without a fit."""
        return 0.0 if self.fit is None or self.fit.line is None else float(self.fit.line.inliers.mean())

    def measured(self, doubtful: BoolArray | None = None) -> NetworkMeasurement:
        """Return the network's measurement alone: empty if the network or the pose is unreliable; without pixels that
        do not show the terrain or show too little (`doubtful`, bool of any size, edge to edge)."""
        fit = self.fit if self.verdict in (FusionVerdict.OK, FusionVerdict.MOSTLY_UNKNOWN) else None
        return measured(fit, self.config, [mask for mask in (self.hidden, doubtful) if mask is not None])

    def network_depth(self) -> Float32Array | None:
        """Return the network's depth (h, w) in metres at its own size, NaN where the terrain is hidden; None if it does
        not fit the terrain."""
        if self.fit is None or self.fit.trouble:
            return None
        with np.errstate(divide="ignore"):
            metres = np.where(self.fit.inverse > 0, 1.0 / self.fit.inverse, np.inf).astype(np.float32)
        if self.hidden is not None:
            metres[hidden_at(self.hidden, *metres.shape)] = np.nan
        return np.asarray(metres, np.float32)


@dataclass(frozen=True, eq=False)
class FusedDepth(FusionOutcome):
    """Fused depth of one photo.

    `depth`, `sigma`: (H, W) float32 metres along the optical axis; +inf sky, NaN unknown (sigma is NaN for both).
    `source`: (H, W) uint8 `DepthSource`. `ground`: (H, W) float32, the traced depth of bare ground, with sky by the
    labels where it is unknown."""

    depth: Float32Array
    sigma: Float32Array
    source: UInt8Array
    ground: Float32Array

    def info(self) -> dict[str, Any]:
        """Return the JSON-ready content of `fused/info`."""
        line = self.fit.line if self.fit is not None else None
        shares = cv2.calcHist([self.source], [0], None, [len(DepthSource)], [0, len(DepthSource)]).ravel() / max(
            1, self.source.size
        )
        return {
            "verdict": self.verdict.value,
            "reason": self.reason,
            "inlier_ratio": round(self.inlier_ratio, 4),
            "scale": line.scale if line is not None else None,
            "shift": line.shift if line is not None else None,
            "share": {source.name.lower(): round(float(shares[source]), 4) for source in DepthSource},
            "pose": {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self.pose).items()},
        }


@dataclass(frozen=True, eq=False)
class Fusion:
    """Fusion of one photo's depths; arguments and errors as of `fuse`, with their defaults in place of None.

    The pose is checked, the network is fitted, and pixels are fused, when that is first requested."""

    traced: RangeImage | DepthImage
    network: NetworkDepth | None
    rgb: UInt8Array
    labels: UInt8Array | None
    classes: ClassPriors
    settings: FusionSettings = field(default_factory=FusionSettings)
    surface: RangeImage | DepthImage | None = None
    config: FusionConfig = field(default_factory=FusionConfig)
    hidden: BoolArray | None = None
    unusable: str = ""

    @cached_property
    def outcome(self) -> FusionOutcome:
        """Return the verdict, the fit and what the network measures, without fusing pixels if possible."""
        if self._refused is not None:
            return FusionOutcome(*self._refused, self._check, None, self.config, self.hidden)
        verdict, reason = self._verdict(self._ground)
        if verdict is FusionVerdict.MOSTLY_UNKNOWN:
            return self.fused  # the network may know some of it
        return FusionOutcome(verdict, reason, self._check, self._fitted[2], self.config, self.hidden)

    @cached_property
    def fused(self) -> FusedDepth:
        """Return the fused depth of every pixel."""
        hidden, config, fit = self.hidden, self.config, None
        if self._refused is not None:
            verdict = self._refused
            ground = self.traced.depth()
            depth = ground if hidden is None else ground.copy()
            sigma = np.full(depth.shape, np.nan, np.float32)
            kinds = DepthSource.TERRAIN, DepthSource.UNKNOWN
            source = np.select((np.isfinite(depth), np.isnan(depth)), kinds, DepthSource.SKY).astype(np.uint8)
        else:
            ground, (depth, sigma, fit) = self._ground, self._fitted
            source = self._fuse(depth, sigma, fit)
            verdict = self._verdict(depth)
        if hidden is not None:
            depth[hidden], sigma[hidden], source[hidden] = np.nan, np.nan, DepthSource.UNKNOWN
            ground = np.where(hidden, np.float32(np.nan), ground)  # a copy: it may be the tracer's own
        return FusedDepth(*verdict, self._check, fit, config, hidden, depth, sigma, source, ground)

    def _fuse(self, depth: Float32Array, sigma: Float32Array, fit: ScaleFit | None) -> UInt8Array:
        """Fuse in place what the terrain predicts; return the sources of the pixels."""
        ground, labels, classes, config = self._ground, self._labels, self.classes, self.config
        camera, seen, view, standing = self.traced.camera, self._seen, None, None
        if fit is not None and not fit.trouble:
            view = NetworkView.of(fit, self.rgb, config)
            standing = OcclusionPrior.of(seen.depth(), labels, classes, camera, seen.pose, view.cells.shape[1:], config)
        # Ridges have their edges where the photo has them; then every pixel is the terrain's, the network's or both's.
        refine_occlusion_boundaries(self.rgb, depth, sigma, ground, labels, classes, camera, config, self.hidden)
        over = None if self.surface is None else self.surface.depth()
        if over is not None and labels is not None:
            over = with_labelled_sky(over, labels, classes.sky)
        source = np.empty(ground.shape, np.uint8)
        fuse_pixels(depth, sigma, over, view, standing, labels, classes, source, config)
        # Where the network alone speaks of land beyond the raster, nothing is known.
        clear_unenclosed(ground, depth, sigma, source)
        return source

    @cached_property
    def _refused(self) -> tuple[FusionVerdict, str] | None:
        """Why nothing is fused. Raises ImageError if sizes differ."""
        size, surface = (self.traced.camera.height, self.traced.camera.width), self.surface
        for what, shape in (
            ("photo", self.rgb.shape[:2]),
            ("label image", size if self.labels is None else self.labels.shape),
            ("surface's depth", size if surface is None else (surface.camera.height, surface.camera.width)),
            ("mask", size if self.hidden is None else self.hidden.shape),
        ):
            if shape != size:
                raise ImageError(f"{what} of {shape} does not fit the traced depth of {size} (rows, columns)")
        if self.unusable:
            return FusionVerdict.PICTURE_UNUSABLE, self.unusable
        ground = self._ground
        # A sample first: where it has ground, as it nearly always does, that is all.
        if not (np.isfinite(ground[::16, ::16]).any() or np.isfinite(ground).any()):
            return FusionVerdict.NO_TERRAIN, "no pixel sees known ground: check pose and DEM"
        return (FusionVerdict.POSE_SUSPECTED, self._check.reason) if self._check.suspected else None

    @cached_property
    def _labels(self) -> UInt8Array | None:
        """The labels, with those expected behind hidden pixels: sky where no ground is traced."""
        if self.labels is None or self.hidden is None:
            return self.labels
        behind = np.where(np.isfinite(self.traced.depth()), np.uint8(UNLABELLED), np.uint8(self.classes.sky))
        return np.asarray(np.where(self.hidden, behind, self.labels), np.uint8)

    @cached_property
    def _ground(self) -> Float32Array:
        """The traced depth of bare ground, with the sky that labels tell."""
        ground = self.traced.depth()
        return ground if self._labels is None else with_labelled_sky(ground, self._labels, self.classes.sky)

    @cached_property
    def _seen(self) -> DepthImage:
        """The ground that is not hidden."""
        ground = self._ground if self.hidden is None else np.where(self.hidden, np.float32(np.nan), self._ground)
        return DepthImage(ground, self.traced.camera, self.traced.pose)

    @cached_property
    def _check(self) -> PoseCheck:
        """Whether the terrain lies where the photo has it: if not, nothing else means anything."""
        if self.unusable:
            return PoseCheck()
        config, sigmas = self.config, (self.settings.angle_sigma, self.settings.dem_sigma)
        given = self.rgb, self._ground, self.traced.camera, *sigmas, config.pose_check
        return check_pose(*given, self._labels, self.classes, config.surface.jump, self.hidden)

    @cached_property
    def _fitted(self) -> tuple[Float32Array, Float32Array, ScaleFit | None]:
        """Depth and sigma of the expected surface, which `fused` changes, and the network's fit."""
        return fitted(self._seen, self.network, self._labels, self.classes, self.settings, self.config)

    def _verdict(self, depth: Float32Array) -> tuple[FusionVerdict, str]:
        """Judge a photo of which this depth is known."""
        fit, hidden = self._fitted[2], self.hidden
        if fit is not None and fit.trouble:
            return FusionVerdict.NETWORK_UNUSABLE, fit.trouble
        # Hidden pixels are no unknown ground.
        unknown = mostly_unknown(depth if hidden is None else np.where(hidden, np.float32(np.inf), depth))
        return (FusionVerdict.MOSTLY_UNKNOWN if unknown else FusionVerdict.OK), unknown


def fuse(
    traced: RangeImage | DepthImage,
    network: NetworkDepth | None,
    rgb: UInt8Array,
    labels: UInt8Array | None,
    classes: ClassPriors,
    settings: FusionSettings | None = None,
    surface: RangeImage | DepthImage | None = None,
    config: FusionConfig | None = None,
    hidden: BoolArray | None = None,
    unusable: str = "",
) -> FusedDepth:
    """Fuse one photo's depths. Raises ImageError if sizes differ.

    `traced`: over bare ground; `surface`: over a surface raster (canopy), if any. `network`: depth of the same photo at
    its own size. `rgb`: (H, W, 3) uint8. `labels`: (H, W) uint8 ids of `classes`. `settings`: sigmas of the inputs.
    `config`: constants fitted with the network. `hidden`: (H, W) bool, pixels that show something else than the
    terrain. `unusable`: why the photo is not used; empty: it is."""
    given = settings or FusionSettings(), surface, config or FusionConfig(), hidden, unusable
    return Fusion(traced, network, rgb, labels, classes, *given).fused
