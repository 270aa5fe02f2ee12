"""Fuse traced depth, photo and labels of a frame; run all steps of a camera on a frame without a graph."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Columns, Float32Array, Float64Array, UInt8Array
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import Fusion
from ltm_core.fuel.vote_columns import no_columns, votes_to_columns
from ltm_core.geometry.range_image import DepthImage
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep, TracingConfig, TracingStep, VotingStep, seen
from ltm_core.raster.dem import Dem
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site import Site
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.masks import Looking
from ltm_core.vision.scene_view import SceneView
from ltm_core.vision.segmenter import Segmentation


class FusingConfig(StrictModel):
    model: str = ""
    """Manifest name or path of a depth network; empty: `depth_model` of the site."""
    label_model: str = ""
    """Manifest name or path of the segmentation network, which states the resolution of its labels; empty: `model` of
    the site."""
    threads: int = Field(1, ge=1)
    """Number of cores that the network may use."""
    angle_sigma_deg: float = Field(0.03, ge=0)
    """Standard deviation of a camera's direction in degrees, in addition to the covariance of its pose."""
    dem_sigma: float = Field(1.0, ge=0)
    """Standard deviation of the terrain's heights in metres."""


@dataclass(frozen=True, eq=False)
class FusedFrame:
    """Fusion of a frame. `view`: scene view of the photo. `trouble`: the error of the network, if it failed; the
    terrain's depth is then used alone."""

    fusion: Fusion
    view: SceneView
    trouble: str = ""


class FusingStep:
    """Fuse a camera's frames. Raises ConfigError without a depth network, ModelError for an invalid one."""

    def __init__(self, site: Site, camera: str, config: FusingConfig) -> None:
        self._config, self._site = config, site
        self._scene = site_scene_filter(site, camera)
        self.label_columns = label_columns(site, camera, config)
        """Columns of the network that makes the labels; 0: unknown."""
        self.network = DepthNetwork(depth_manifest(site, camera, config), config.threads)
        self._classes = ClassPriors.of(LabelSet.load(config_path(site.labels)), self.network.fusion)
        # Bare earth is asked for only where depth is traced to something else.
        self.trace_to(None if site.surface is None else site.open_dem())

    def trace_to(self, ground: Dem | None) -> None:
        """Use this terrain from now on. `ground`: bare earth if depth is traced to objects on it; it is then traced as
        well."""
        rays = self._site.curvature, self._site.refraction, self._site.possible_ground
        self._ground = None if ground is None else TerrainTracer(ground, *rays)

    def fuse(
        self,
        depth: Float32Array,
        frame: PosedImage,
        labels: UInt8Array | None,
        covariance: Float64Array | None,
        view: SceneView | None = None,
    ) -> FusedFrame:
        """Fuse a frame. `depth`: (H, W) traced, along the optical axis. `labels`: (H, W) class ids; None: missing.
        `covariance`: (6, 6) of the pose; None: unknown. `view`: scene view of the photo, if already known.

        Raises ImageError and PoseError as `fuse` and the tracer do."""
        looking = Looking.of(frame.camera, frame.pose)
        seen = self._scene.look(frame.image, looking, frame.stamp_ns) if view is None else view
        photo = seen.scene(frame.image)
        network, trouble = None, ""
        try:
            network = self.network.predict(photo, frame.camera) if seen.reason is None else None
        except ModelError as error:
            trouble = str(error)
        traced = DepthImage(depth, frame.camera, frame.pose)
        known = labels, self._classes, self._settings(covariance)
        scene = self.network.fusion, seen.hidden, seen.unusable
        if self._ground is None:
            return FusedFrame(Fusion(traced, network, photo, *known, None, *scene), seen, trouble)
        ground = self._ground.trace(frame.camera, frame.pose)
        return FusedFrame(Fusion(ground, network, photo, *known, traced, *scene), seen, trouble)

    def _settings(self, covariance: Float64Array | None) -> FusionSettings:
        """Return the settings with the sigma of the camera's direction from its pose's covariance, if given."""
        known = 0.0 if covariance is None else float(covariance.diagonal()[3:].max())
        angle = np.radians(self._config.angle_sigma_deg)
        return FusionSettings(
            float(np.sqrt(angle**2 + known)), self._config.dem_sigma, label_columns=self.label_columns
        )


def depth_manifest(site: Site, camera: str, config: FusingConfig) -> NetworkManifest:
    """Return the depth network of a camera; with a label head, that of the network which the head corrects, so that the
    encoder runs once. Raises ConfigError if the site names none, ModelError if it is missing."""
    model = config.model or site.depth_model
    if not model:
        raise ConfigError(f"site {site.name}: no depth network; set `depth_model` to a manifest's name or path")
    return NetworkManifest.find(model).serving(site.camera(camera).label_head)


def label_columns(site: Site, camera: str, config: FusingConfig) -> int:
    """Return the columns of the network that labels a camera's images; 0 if it is unknown here, because another
    computer may run it."""
    try:
        return (
            NetworkManifest.find(config.label_model or site.model).serving(site.camera(camera).label_head).label_columns
        )
    except ModelError:
        return 0


@dataclass(frozen=True)
class FrameVotes:
    """Votes of a frame: `columns` as in `vote_columns`; `reason`: why its image was not used, or empty."""

    columns: Columns
    reason: str


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """Depth measured for the terrain: `depth`, `sigma` (h, w) metres from the depth network, NaN where it measures
    nothing; `labels` (H, W) class ids. `trouble`: the error of the network, if it failed."""

    depth: Float32Array
    sigma: Float32Array
    labels: UInt8Array
    trouble: str = ""


class FrameSteps:
    """All steps for the frames of one camera; frames may come in any order, so smoke, which needs earlier images, is
    not detected. `fusing`: None if measurements are not needed."""

    def __init__(
        self,
        site: Site,
        camera: str,
        tracing: TracingConfig,
        labelling: LabellingConfig,
        fusing: FusingConfig | None = None,
    ) -> None:
        self.tracing = TracingStep(site, camera, tracing)
        self.labelling = LabellingStep(site, camera, labelling)
        self.voting = VotingStep(site, camera)
        self.fusing = None if fusing is None else FusingStep(site, camera, fusing)

    @property
    def described(self) -> str:
        """Return the name and checksum of the label network."""
        return self.labelling.described

    def of(self, frame: PosedImage) -> FrameAtWork:
        """Return the steps of a frame, for the requested results."""
        return FrameAtWork(self, frame)


class FrameAtWork:
    """Frame in the steps of its camera: each step runs once, when its result is first requested, so that votes do not
    depend on whether measurements are requested. Methods raise LtmError as the steps do."""

    def __init__(self, steps: FrameSteps, frame: PosedImage) -> None:
        self._steps, self._frame = steps, frame

    def votes(self, covariance: Float64Array | None) -> FrameVotes:
        """Return the votes. `covariance`: (6, 6) of the frame's pose; None: it is exact."""
        found, view = self._labelled
        if view.reason is not None:
            return FrameVotes(no_columns(), view.unusable)  # an image that shows nothing needs no ranges
        frame, voting = self._frame, self._steps.voting
        cast = voting.cast(self._depth, frame.camera, frame.pose, found, frame.stamp_ns, covariance)
        return FrameVotes(votes_to_columns(voting.carried(cast), voting.labels.names), view.unusable)

    def measured(self, covariance: Float64Array | None) -> MeasuredFrame:
        """Return the measurement of steps that fuse. `covariance`: (6, 6) of the frame's pose; None: unknown."""
        assert self._steps.fusing is not None  # nosec B101 # tells the type checker what holds
        found, view = self._labelled
        fused = self._steps.fusing.fuse(self._depth, self._frame, found.labels, covariance, view)
        measured = fused.fusion.outcome.measured(view.doubtful)
        return MeasuredFrame(measured.depth, measured.sigma, found.labels, fused.trouble)

    @cached_property
    def _labelled(self) -> tuple[Segmentation, SceneView]:
        frame = self._frame
        looking = Looking.of(frame.camera, frame.pose)
        return self._steps.labelling.label(frame.image, looking, frame.stamp_ns, in_order=False)

    @cached_property
    def _depth(self) -> Float32Array:
        """Return (H, W) traced, along the optical axis."""
        camera, pose, tracing = self._frame.camera, self._frame.pose, self._steps.tracing
        return seen(tracing.trace(camera, pose).ranges.depth(), tracing.hidden(camera, pose))
