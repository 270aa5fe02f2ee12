"""TopoDepth: traced depth and a network's depth of one photo made one, pixel by pixel, by what each is worth there.

After the paper's pixel sampling and RANSAC regression (the LTM paper, after FireLoc): the network's free scale comes
from pixels whose terrain can be trusted, and so does what the network says where the depth is known. The terrain's
answer is brought to the visible surface, by the height of what the labels say grows there or by a canopy raster, and at
silhouettes by the photo. Then every pixel is decided: see `pixel_fusion`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple

import cv2
import numpy as np

from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.depth_discontinuities import DepthDiscontinuities
from ltm_core.depth.expected_surface import expected_surface
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ground_samples
from ltm_core.depth.guided_upsampling import NetworkView
from ltm_core.depth.hidden_pixels import edges_seen, hidden_at, labels_behind
from ltm_core.depth.labelled_sky import with_labelled_sky
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.network_measurement import NetworkMeasurement
from ltm_core.depth.occlusion_boundaries import refine_occlusion_boundaries
from ltm_core.depth.occlusion_prior import OcclusionPrior
from ltm_core.depth.pixel_fusion import fuse_pixels
from ltm_core.depth.pose_check import PoseCheck, check_pose
from ltm_core.depth.scale_fit import ScaleFit, fit_scale
from ltm_core.depth.unknown_regions import clear_unenclosed
from ltm_core.errors import ImageError
from ltm_core.range_image import DepthImage, RangeImage
from ltm_core.types import BoolArray, Float32Array, UInt8Array
from ltm_core.unknown_share import MOST_UNKNOWN, unknown_share


class Source(IntEnum):
    """Where a pixel's depth comes from: the values of `FusedDepth.source`."""

    UNKNOWN = 0
    TERRAIN = 1
    NETWORK = 2
    BOTH = 3
    SKY = 4


class Verdict(StrEnum):
    """Whether an image's fused depth can be relied on."""

    OK = "ok"
    POSE_SUSPECTED = "pose_suspected"
    """The terrain does not lie where the photo has it: traced depth as it is, nothing fused."""
    NETWORK_UNUSABLE = "network_unusable"
    """The network's depth does not fit the terrain: the terrain's answer alone, refined by photo and labels."""
    NO_TERRAIN = "no_terrain"
    """No pixel was traced to known ground."""
    MOSTLY_UNKNOWN = "mostly_unknown"
    """As ok, but of most of the photo nothing is known: the terrain explains too little of it."""
    PICTURE_UNUSABLE = "picture_unusable"
    """The photo shows too little of the landscape, by night or in fog: traced depth as it is, nothing fused."""


@dataclass(frozen=True)
class FusionSettings:
    """angle_sigma: of a camera's direction, radians, beside what its pose's covariance says. dem_sigma: of the
    terrain's heights, metres. label_columns: of the network that made the labels, whose edges are no finer; 0: they
    are the photo's own."""

    angle_sigma: float = float(np.radians(0.03))
    dem_sigma: float = 1.0
    label_columns: int = 0


@dataclass(frozen=True, eq=False)
class FusedDepth:
    """Fused depth of one photo.

    `depth`, `sigma`: (H, W) float32 metres along the optical axis; +inf sky, NaN unknown (sigma is NaN for both).
    `source`: (H, W) uint8 `Source`. `ground`: (H, W) float32, the traced depth of bare ground, sky where labels say so
    of what is unknown: where it differs from `depth`, what is seen stands before it. `inlier_ratio`: of the network's
    fit to trusted ground. `verdict`, and `reason` in words where it is not ok. `fit`: the network's fit, None where
    there was no network. `hidden`: (H, W) bool, where something else stands before the terrain and there is no depth;
    None: nowhere.
    """

    depth: Float32Array
    sigma: Float32Array
    source: UInt8Array
    ground: Float32Array
    inlier_ratio: float
    verdict: Verdict
    reason: str
    pose: PoseCheck
    config: FusionConfig = field(repr=False)
    fit: ScaleFit | None = field(default=None, repr=False)
    hidden: BoolArray | None = field(default=None, repr=False)

    def measured(self, doubtful: BoolArray | None = None) -> NetworkMeasurement:
        """What the network alone measures: nothing where it, or the pose, cannot be relied on, where something else
        stands before the terrain, and where the photo shows too little (`doubtful`, bool of any size, edge to edge)."""
        if self.fit is None or self.verdict not in (Verdict.OK, Verdict.MOSTLY_UNKNOWN):
            return NetworkMeasurement.none()
        found = NetworkMeasurement.of(self.fit, self.config)
        for unseen in (self.hidden, doubtful):
            if unseen is not None:
                found = found.without(hidden_at(unseen, *found.depth.shape))
        return found

    def network_depth(self) -> Float32Array | None:
        """Metres (h, w) that the network says at its own size, none where the terrain is hidden; None where it does not
        fit the terrain."""
        if self.fit is None or self.fit.trouble:
            return None
        with np.errstate(divide="ignore"):
            metres = np.where(self.fit.inverse > 0, 1.0 / self.fit.inverse, np.inf).astype(np.float32)
        if self.hidden is not None:
            metres[hidden_at(self.hidden, *metres.shape)] = np.nan
        return np.asarray(metres, np.float32)

    def info(self) -> dict[str, Any]:
        """JSON-ready: what `fused/info` carries."""
        line = self.fit.line if self.fit is not None else None
        shares = cv2.calcHist([self.source], [0], None, [len(Source)], [0, len(Source)]).ravel() / max(
            1, self.source.size
        )
        return {
            "verdict": self.verdict.value,
            "reason": self.reason,
            "inlier_ratio": round(self.inlier_ratio, 4),
            "scale": line.scale if line is not None else None,
            "shift": line.shift if line is not None else None,
            "regional": bool(self.fit is not None and self.fit.error_model.regional),
            "share": {source.name.lower(): round(float(shares[source]), 4) for source in Source},
            "pose": {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self.pose).items()},
        }


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
    """Fuse one photo's depths.

    Args:
        traced: what the tracer gave over bare ground.
        network: the network's depth of the same photo at its own size; None: terrain, labels and photo alone.
        rgb: (H, W, 3) uint8, the photo.
        labels: (H, W) uint8 class ids, or None.
        classes: what these mean.
        settings: sigmas of what goes in.
        surface: what the tracer gave over a surface raster (canopy), where there is one.
        config: the constants, as they were fitted with the network; None: the defaults.
        hidden: (H, W) bool, where the photo shows something else than the terrain: no depth there, and nothing of it is
            used; None: nowhere.
        unusable: why the photo shows too little to be used; empty: it is used.

    Raises ImageError where sizes differ.
    """
    as_traced = traced.depth()
    size = as_traced.shape
    for what, shape in (
        ("photo", rgb.shape[:2]),
        ("label image", size if labels is None else labels.shape),
        ("surface's depth", size if surface is None else (surface.camera.height, surface.camera.width)),
        ("mask", size if hidden is None else hidden.shape),
    ):
        if shape != size:
            raise ImageError(f"{what} of {shape} does not fit the traced depth of {size} (rows, columns)")
    settings = FusionSettings() if settings is None else settings
    config = FusionConfig() if config is None else config
    camera = traced.camera
    ground, over = as_traced, None if surface is None else surface.depth()
    if unusable:
        return _traced_alone(as_traced, Verdict.PICTURE_UNUSABLE, unusable, PoseCheck.none(), hidden)
    if labels is not None and hidden is not None:
        labels = labels_behind(hidden, labels, ground, classes.sky)
    if labels is not None:
        ground = with_labelled_sky(ground, labels, classes.sky)
        over = None if over is None else with_labelled_sky(over, labels, classes.sky)
    cell = max(1.0, size[1] / settings.label_columns) if settings.label_columns else 1.0
    # Whether the terrain lies where the photo has it: if not, nothing below means anything.
    edges = DepthDiscontinuities.of(ground, config.surface.jump)
    if hidden is not None:
        edges = edges_seen(edges, hidden)
    sigmas = settings.angle_sigma, settings.dem_sigma
    check = PoseCheck.none()
    if config.pose_check.enabled:
        check = check_pose(rgb, ground, camera, *sigmas, config.pose_check, labels, classes, cell, edges)
    # A sample first: where it has ground, as it nearly always does, that is all.
    if not (np.isfinite(ground[::16, ::16]).any() or np.isfinite(ground).any()):
        return _traced_alone(
            as_traced, Verdict.NO_TERRAIN, "no pixel sees known ground: check pose and DEM", check, hidden
        )
    if check.suspected:
        return _traced_alone(as_traced, Verdict.POSE_SUSPECTED, check.reason, check, hidden)
    seen = ground if hidden is None else np.where(hidden, np.float32(np.nan), ground)
    told = DepthImage(seen, camera, traced.pose)
    expected, sigma, fit, view, standing = expect(told, network, rgb, labels, classes, settings, config)
    # Ridges have their edges where the photo has them; then every pixel is the terrain's, the network's or both's.
    refine_occlusion_boundaries(rgb, ground, expected, sigma, labels, classes, camera, config, view, edges)
    source = np.empty(size, np.uint8)
    fuse_pixels(expected, sigma, over, view, standing, labels, classes, source, config)
    # Where the network alone speaks of land beyond the raster, nothing is known.
    clear_unenclosed(ground, expected, sigma, source)
    verdict, reason, ratio = Verdict.OK, "", 0.0 if fit is None else fit.inlier_ratio
    if hidden is not None:
        expected[hidden] = np.inf  # no unknown ground: it is asked what of it the terrain leaves unexplained
    unknown = unknown_share(expected)
    if unknown.whole > MOST_UNKNOWN:
        verdict, reason = Verdict.MOSTLY_UNKNOWN, unknown.reason
    if fit is not None and fit.trouble:
        verdict, reason = Verdict.NETWORK_UNUSABLE, fit.trouble
    ground = _hide(hidden, expected, sigma, source, ground)
    return FusedDepth(expected, sigma, source, ground, ratio, verdict, reason, check, config, fit, hidden)


class Expectation(NamedTuple):
    """What is known of a photo's pixels before any of them is decided: depth and sigma (H, W) that the terrain lets
    expect; the network's fit, its view of the photo, and what may stand before the ground, None without a network."""

    depth: Float32Array
    sigma: Float32Array
    fit: ScaleFit | None
    view: NetworkView | None
    standing: OcclusionPrior | None


def expect(
    traced: RangeImage | DepthImage,
    network: NetworkDepth | None,
    rgb: UInt8Array,
    labels: UInt8Array | None,
    classes: ClassPriors,
    settings: FusionSettings,
    config: FusionConfig,
) -> Expectation:
    """The first half of `fuse`; arguments as there."""
    ground, camera, pose = traced.depth(), traced.camera, traced.pose
    # What the terrain lets expect: bare ground, with the height of what grows there.
    sigmas = settings.angle_sigma, settings.dem_sigma
    expected, sigma = expected_surface(ground, labels, classes.cover, camera, pose, *sigmas, config)
    if network is None:
        return Expectation(expected, sigma, None, None, None)
    # Pixel sampling and RANSAC regression: the network's scale from ground that can be trusted, and its errors there.
    samples = ground_samples(expected, sigma, labels, classes.ground, camera.fy, config)
    fit = fit_scale(network, samples, (ground.shape[0], ground.shape[1]), config)
    if fit.trouble:
        return Expectation(expected, sigma, fit, None, None)
    view = NetworkView.of(fit, rgb, config)
    standing = OcclusionPrior.of(ground, labels, classes, camera, pose, view.shape, config)
    return Expectation(expected, sigma, fit, view, standing)


def _traced_alone(
    traced: Float32Array, verdict: Verdict, reason: str, check: PoseCheck, hidden: BoolArray | None
) -> FusedDepth:
    source = np.where(np.isfinite(traced), Source.TERRAIN, np.where(np.isnan(traced), Source.UNKNOWN, Source.SKY))
    source = source.astype(np.uint8)
    sigma = np.full(traced.shape, np.nan, np.float32)
    depth = traced if hidden is None else traced.copy()
    ground = _hide(hidden, depth, sigma, source, traced)
    return FusedDepth(depth, sigma, source, ground, 0.0, verdict, reason, check, FusionConfig(), None, hidden)


def _hide(
    hidden: BoolArray | None, depth: Float32Array, sigma: Float32Array, source: UInt8Array, ground: Float32Array
) -> Float32Array:
    """Take away, in place, what hidden pixels have; the ground (not in place: it may be the tracer's own)."""
    if hidden is None:
        return ground
    depth[hidden], sigma[hidden], source[hidden] = np.nan, np.nan, Source.UNKNOWN
    return np.asarray(np.where(hidden, np.float32(np.nan), ground), np.float32)
