"""Fuse traced depth, photo and labels of a frame."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import Fusion
from ltm_core.geometry.range_image import DepthImage
from ltm_core.pipeline.frame import PosedImage
from ltm_core.raster.dem import Dem
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site import Site
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.masks import Looking
from ltm_core.vision.scene_view import SceneView


class FusingConfig(StrictModel):
    model: str = ""
    """Manifest name or path of a depth network; empty: `depth_model` of the site."""
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
        if not (model := config.model or site.depth_model):
            raise ConfigError(f"site {site.name}: no depth network; set `depth_model` to a manifest's name or path")
        # With a label head, that of the network which the head corrects, so that the encoder runs once.
        manifest = NetworkManifest.find(model).serving(site.camera(camera).label_head)
        self.network = DepthNetwork(manifest, config.threads)
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
        return FusionSettings(float(np.sqrt(angle**2 + known)), self._config.dem_sigma)
