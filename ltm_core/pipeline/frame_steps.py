"""Run the steps from a posed frame to votes, each once for a camera: trace, label, vote.

The nodes `depth`, `segmentation` and `fuel_votes` are these steps with messages around them, and `FrameSteps`
(`frame_at_work`) is the three in a row for whoever has a frame and no graph. So there is one place for each step's
arguments, and a frame has the same votes, to the last bit, whoever works on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from pydantic import Field

from ltm_core.base.errors import PoseError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.fuel.label_errors import known_errors
from ltm_core.fuel.life_form import GroundLimits
from ltm_core.fuel.vote_columns import fitting, turn_of
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.pipeline.site_surface import given_terrain
from ltm_core.site.networks import label_network, prompt_segmenter, site_scene_filter, site_segmenter
from ltm_core.site.site import Site
from ltm_core.surface.confirmed_surface import AS_GIVEN
from ltm_core.surface.surface_versions_io import ConfirmedTerrain
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.tracer import TracerStatistics
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_core.vision.manifest import NetworkManifest, Withdrawal
from ltm_core.vision.masks import Looking
from ltm_core.vision.scene_view import SceneView
from ltm_core.vision.segmenter import Segmentation, Segmenter
from ltm_core.vision.smoke import SmokeMemory


class TracingConfig(StrictModel):
    surface: bool = True
    """Whether to trace to the tops of trees and buildings where the site has a surface raster. Both hits are kept; the
    one on bare earth is published on `depth/ground` while the topic has subscribers."""


class LabellingConfig(StrictModel):
    model: str = ""
    """Manifest name or path of the network; empty: that of the site."""
    threads: int = Field(1, ge=1)
    """Number of cores that the network may use."""
    confidence: float | None = Field(None, ge=0, lt=1)
    """Probability below which labels are withdrawn; None: the value of the network's manifest or the camera's label
    head."""
    tree_contrast: float | None = Field(None, ge=0)
    """Local contrast in 8-bit steps below which *tree* is withdrawn if the image shows more shrub, because hazy far
    slopes are labelled as trees; None: the value of the network's manifest or the camera's label head."""


@dataclass(frozen=True, eq=False)
class _Tracers:
    """Over one terrain. `version`: of the confirmed surface. `bare`: the same where nothing stands on bare earth."""

    version: str
    tracer: TerrainTracer
    bare: TerrainTracer


@dataclass(frozen=True, eq=False)
class TracedFrame:
    """Traced frame. `ranges`: to the visible terrain. `over`: the terrain it was traced on."""

    ranges: RangeImage
    over: _Tracers

    @property
    def version(self) -> str:
        """Return the version of the confirmed surface; AS_GIVEN for the site's rasters."""
        return self.over.version

    def bare_earth(self) -> RangeImage:
        """Return the ranges to bare earth of the same version; the same ranges if nothing is known to stand on it."""
        over, seen_from = self.over, self.ranges
        return seen_from if over.bare is over.tracer else over.bare.trace(seen_from.camera, seen_from.pose)


class TracingStep:
    """Trace every pixel of a camera to the terrain. Raises ConfigError and RasterError as the site does."""

    def __init__(self, site: Site, camera: str, config: TracingConfig) -> None:
        self._scene = site_scene_filter(site, camera)
        self._site, self._surface = site, config.surface
        self._given: _Tracers | None = None
        self.trace_to(given_terrain(site))

    def trace_to(self, terrain: ConfirmedTerrain) -> None:
        """Use this terrain from now on. It is built completely before it replaces the previous one. Raises
        RasterError."""
        self._over = self._tracers(terrain)

    def trace(self, camera: Camera, pose: Pose) -> TracedFrame:
        """Trace a frame. Raises PoseError as the tracer does; but a frame from below a confirmed surface (growth around
        a mast) is traced to the terrain as given."""
        over = self._over
        try:
            return TracedFrame(over.tracer.trace(camera, pose), over)
        except PoseError:
            if over.version == AS_GIVEN:
                raise
        if self._given is None:
            self._given = self._tracers(given_terrain(self._site))
        return TracedFrame(self._given.tracer.trace(camera, pose), self._given)

    @property
    def statistics(self) -> TracerStatistics:
        """Return the statistics of the tracer in use."""
        return self._over.tracer.statistics

    @property
    def version(self) -> str:
        """Return the version of the confirmed surface in use."""
        return self._over.version

    def hidden(self, camera: Camera, pose: Pose) -> BoolArray | None:
        """Return (H, W) bool, True where the mask of this direction hides the landscape; None: nowhere."""
        return self._scene.hidden(camera.width, camera.height, Looking.of(camera, pose))

    def _tracers(self, terrain: ConfirmedTerrain) -> _Tracers:
        site, top = self._site, terrain.top if self._surface else terrain.ground
        rays = site.curvature, site.refraction, site.possible_ground
        tracer = TerrainTracer(top, *rays)
        bare = tracer if top is terrain.ground else TerrainTracer(terrain.ground, *rays)
        return _Tracers(terrain.name, tracer, bare)


def seen(values: Float32Array, hidden: BoolArray | None) -> Float32Array:
    """Return depths (H, W) or points (H, W, 3), NaN where `hidden` (H, W) is True."""
    if hidden is None:
        return values
    result = values.copy()
    result[hidden] = np.nan
    return result


class LabellingStep:
    """Label every pixel of a camera's images. Raises ConfigError, ModelError for an invalid network."""

    def __init__(self, site: Site, camera: str, config: LabellingConfig) -> None:
        self._scene = site_scene_filter(site, camera)
        own = site.camera(camera)
        self._smoke = SmokeMemory() if own.judge_pictures and own.judge_smoke else None
        self._site, self._config = site, config
        self._prompt: tuple[str, Segmenter] | None = None
        self._segmenter = site_segmenter(site, camera, config.model, config.threads)
        network = label_network(site, config.model or site.model)
        self._reliability = known_errors(network, own.label_head, site.label_heads).state
        chosen = {"confidence": config.confidence, "tree_contrast": config.tree_contrast}
        given = {name: value for name, value in chosen.items() if value is not None}
        self._segmenter.withdraw_otherwise = given

    @property
    def described(self) -> str:
        """Return the name and checksum of the label network."""
        return self._segmenter.described

    @property
    def reliability(self) -> str:
        """Return what the labels were measured on (`LabelErrors.state`)."""
        return self._reliability

    @property
    def manifest(self) -> NetworkManifest:
        """Return the network's manifest."""
        return self._segmenter.manifest

    @property
    def withdrawal(self) -> Withdrawal:
        """Return which labels are withdrawn."""
        return self._segmenter.withdrawal

    @property
    def by_view(self) -> bool:
        """Return whether the camera has masks of single views, so that labels depend on the viewing direction."""
        return self._scene.by_view

    def label(
        self,
        photo: UInt8Array,
        looking: Looking | None = None,
        stamp_ns: int | None = None,
        in_order: bool = True,
    ) -> tuple[Segmentation, SceneView]:
        """Label an image (H, W, 3) RGB. Return its labels and the scene view.

        `looking`: viewing direction; None: only the mask of all views is used. `stamp_ns`: time of the image; None:
        unknown. `in_order`: images arrive in the order of their times, so that smoke is detected by comparison with
        previous ones; a single image shows no smoke."""
        view = self._scene.look(photo, looking, stamp_ns)
        among_others_s = stamp_ns * 1e-9 if stamp_ns is not None and in_order else None
        if view.reason is None:
            found = self._segmenter.segment(view.scene(photo))
        else:
            found = Segmentation(np.zeros(photo.shape[:2], np.uint8), np.zeros(photo.shape[:2], np.uint8))
        view.unlabelled(found.labels, found.confidence)
        if self._smoke is None or among_others_s is None or view.reason is not None:
            return found, view
        smoke = self._smoke.look(photo, found.labels, among_others_s)
        if smoke is None:
            return found, view
        gone = smoke & (found.labels != Label.SKY) & (found.labels != UNLABELLED)
        found.labels[gone], found.confidence[gone] = UNLABELLED, 0
        return found, replace(view, smoke=float(gone.mean()))

    def show(self, prompt: str) -> None:
        """Compute `heat` for a prompt from now on; empty: for none. Raises ConfigError, ModelError as
        `prompt_segmenter`; the previous prompt then remains."""
        words = " ".join(prompt.split())
        made = prompt_segmenter(self._site, self._config.model, words, self._config.threads) if words else None
        self._prompt = None if made is None else (words, made)

    def heat(self, photo: UInt8Array, view: SceneView) -> UInt8Array | None:
        """Return (H, W) probability of the prompt x 255 among the classes of the site; None without a prompt. It never
        votes."""
        if self._prompt is None:
            return None
        words, segmenter = self._prompt
        height, width = photo.shape[:2]
        chance = segmenter.class_probabilities(view.scene(photo))[words]
        found = np.asarray(np.rint(255 * cv2.resize(chance, (width, height))), np.uint8)
        view.unlabelled(np.zeros((height, width), np.uint8), found)
        return found


class VotingStep:
    """Convert a camera's depth and labels to votes for the fuel cells that it sees."""

    def __init__(self, site: Site, camera: str) -> None:
        self._camera = camera
        site.camera(camera)
        dem = site.open_dem()
        self.labels = LabelSet.load(config_path(site.labels))
        self.geometry = site.fuel_geometry(dem)
        votes_for = self.labels.votes_table[: len(self.labels)]
        limits = GroundLimits(site.fuel.growth, self.geometry, dem, self.labels)
        self._caster = VoteCaster(self.geometry, dem, votes_for, site.fuel.max_range, site.bend, limits)
        self.assumed = site.assumed_pose_error.covariance()
        """(6, 6) covariance assumed for poses without one."""

    def cast(
        self,
        depth: Float32Array,
        camera: Camera,
        pose: Pose,
        found: Segmentation,
        stamp_ns: int,
        covariance: Float64Array | None,
    ) -> CellVotes:
        """Return all votes of a frame. `depth`: (H, W) along the optical axis; `covariance`: (6, 6) of the pose, None:
        it is exact. Raises ImageError, PoseError as `VoteCaster.cast` does."""
        return self._caster.cast(
            depth, camera, pose, found.labels, stamp_ns, self._camera, found.confidence, covariance
        )

    def carried(self, votes: CellVotes) -> CellVotes:
        """Return the votes that are counted: those that fit into a message (`vote_columns.fitting`)."""
        return fitting(votes, turn_of(votes.stamp_ns))
