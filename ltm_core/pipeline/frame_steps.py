"""Run the steps from a posed frame to votes, each once for a camera: trace, label, vote.

The nodes `depth`, `segmentation` and `fuel_votes` are these steps with messages around them, and `ltm reprocess` runs
the three in a row without a graph. A frame has the same votes, to the last bit, in both."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import cv2
import numpy as np
from pydantic import Field

from ltm_core.base.errors import PoseError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.fuel.label_errors import known_errors
from ltm_core.fuel.life_form import WATER_STEEPEST_DEG, GroundLimits
from ltm_core.fuel.vote_columns import fitting
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.site_surface import given_terrain
from ltm_core.site.networks import label_network, prompt_segmenter, site_scene_filter, site_segmenter
from ltm_core.site.site import Site
from ltm_core.surface.confirmed_surface import AS_GIVEN
from ltm_core.surface.surface_versions_io import ConfirmedTerrain
from ltm_core.tracing.tracer import TerrainTracer
from ltm_core.visibility.footprint import ground_normals
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
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


@dataclass(frozen=True, eq=False)
class Tracers:
    """Tracers over one terrain. `version`: of the confirmed surface, AS_GIVEN for the site's rasters. `bare`: over bare
    earth, or `tracer` itself if nothing stands on it."""

    version: str
    tracer: TerrainTracer
    bare: TerrainTracer


@dataclass(frozen=True, eq=False)
class TracedFrame:
    """Traced frame. `ranges`: to the visible terrain. `over`: the terrain it was traced on."""

    ranges: RangeImage
    over: Tracers

    def bare_earth(self) -> RangeImage:
        """Return the ranges to bare earth of the same version; the same ranges if nothing is known to stand on it."""
        over, seen_from = self.over, self.ranges
        return seen_from if over.bare is over.tracer else over.bare.trace(seen_from.camera, seen_from.pose)


class TracingStep:
    """Trace every pixel of a camera to the terrain. Raises ConfigError and RasterError as the site does."""

    def __init__(self, site: Site, camera: str, config: TracingConfig) -> None:
        self._scene = site_scene_filter(site, camera)
        self._site, self._surface = site, config.surface
        self._given: Tracers | None = None
        self.trace_to(given_terrain(site))

    def trace_to(self, terrain: ConfirmedTerrain) -> None:
        """Use this terrain from now on. It is built completely before it replaces the previous one. Raises
        RasterError."""
        self.over = self._tracers(terrain)

    def trace(self, camera: Camera, pose: Pose) -> TracedFrame:
        """Trace a frame. Raises PoseError as the tracer does; but a frame from below a confirmed surface (growth around
        a mast) is traced to the terrain as given."""
        over = self.over
        try:
            return TracedFrame(over.tracer.trace(camera, pose), over)
        except PoseError:
            if over.version == AS_GIVEN:
                raise
        if self._given is None:
            self._given = self._tracers(given_terrain(self._site))
        return TracedFrame(self._given.tracer.trace(camera, pose), self._given)

    def hidden(self, camera: Camera, pose: Pose) -> BoolArray | None:
        """Return (H, W) bool, True where the mask of this direction hides the landscape; None: nowhere."""
        return self._scene.hidden(camera.width, camera.height, Looking.of(camera, pose))

    def _tracers(self, terrain: ConfirmedTerrain) -> Tracers:
        site, top = self._site, terrain.top if self._surface else terrain.ground
        rays = site.curvature, site.refraction, site.possible_ground
        tracer = TerrainTracer(top, *rays)
        bare = tracer if top is terrain.ground else TerrainTracer(terrain.ground, *rays)
        return Tracers(terrain.name, tracer, bare)


def seen(values: Float32Array, hidden: BoolArray | None) -> Float32Array:
    """Return depths (H, W) or points (H, W, 3), NaN where `hidden` (H, W) is True."""
    if hidden is None:
        return values
    result = values.copy()
    result[hidden] = np.nan
    return result


_LONGER_SIDE: Final = 96
"""Longer side in pixels of the reduced image at which the terrain is traced for its labels."""
_SIGMAS: Final = 3.0
"""Error of the pose in standard deviations within which the terrain says nothing of a pixel."""
_MOST_ANGLE_SIGMA: Final = math.radians(1.0)
"""Standard deviation of the direction above which the terrain is not used, in radians."""
_HALF_SLOPE: Final = 15.0
"""Half of the distance over which a slope is measured, in metres: a fuel cell."""


class UnlikelyLabels:
    """Determine where the terrain makes labels unlikely: sky on ground, water on slopes."""

    def __init__(self, tracer: TerrainTracer) -> None:
        self._tracer = tracer
        self._last: tuple[object, dict[int, BoolArray]] = None, {}

    def of(self, camera: Camera, pose: Pose, covariance: Float64Array | None) -> dict[int, BoolArray]:
        """Return by label id the pixels (h, w) of the reduced image where the label is unlikely, whatever the error of
        the pose. `covariance`: (6, 6) of the pose; None: it is exact. Empty where the pose is in doubt."""
        variances = np.zeros((2, 3)) if covariance is None else np.abs(covariance.diagonal()).reshape(2, 3)
        place, angle = np.sqrt(variances.max(axis=1)).tolist()
        key = camera, pose.position.tobytes(), pose.rotation.tobytes(), place, angle
        if self._last[0] != key:
            self._last = key, self._traced(camera, pose, place, angle)
        return self._last[1]

    def _traced(self, camera: Camera, pose: Pose, place: float, angle: float) -> dict[int, BoolArray]:
        scale = _LONGER_SIDE / max(camera.width, camera.height)
        small = camera.resized(*(max(1, round(scale * side)) for side in (camera.width, camera.height)))
        if not (angle <= _MOST_ANGLE_SIGMA and _SIGMAS * angle * small.fx < _LONGER_SIDE):
            return {}
        edge = math.ceil(_SIGMAS * angle * small.fx) + 1  # what the pose's error may bring into the image
        width, height = small.width + 2 * edge, small.height + 2 * edge
        wide = replace(small, width=width, height=height, cx=small.cx + edge, cy=small.cy + edge)
        try:
            traced = self._tracer.trace(wide, pose, "pyramid")  # it leaves the caches to tracers of whole images
        except PoseError:
            return {}  # the node `depth` reports it
        ground = np.isfinite(traced.range)
        x, y = traced.points()[ground][:, :2].T.astype(np.float64)
        steep = np.zeros(ground.shape, np.bool_)
        upward = ground_normals(self._tracer.dem, x, y, _HALF_SLOPE)[:, 2]
        steep[ground] = upward < math.cos(math.radians(WATER_STEEPEST_DEG))
        margin = 1 + _SIGMAS * small.fx * np.hypot(angle, place / traced.range)
        inside = np.s_[edge:-edge, edge:-edge]
        return {
            int(label): (cv2.distanceTransform(where.astype(np.uint8), cv2.DIST_L2, 3) > margin)[inside]
            for label, where in ((Label.SKY, ground), (Label.WATER, steep))
        }


class LabellingStep:
    """Label every pixel of a camera's images. Raises ConfigError, ModelError for an invalid network."""

    def __init__(self, site: Site, camera: str, config: LabellingConfig) -> None:
        self._scene = site_scene_filter(site, camera)
        own = site.camera(camera)
        self._smoke = SmokeMemory() if own.judge_pictures and own.judge_smoke else None
        self._site, self._config = site, config
        self._prompt: tuple[str, Segmenter] | None = None
        self.segmenter = site_segmenter(site, camera, config.model, config.threads)
        network = label_network(site, config.model or site.model)
        self.reliability = known_errors(network, own.label_head, site.label_heads).state
        """What the labels were measured on (`LabelErrors.state`)."""
        self.segmenter.withdraw_otherwise = config.model_dump(include={"confidence"}, exclude_none=True)

    @cached_property
    def _terrain(self) -> UnlikelyLabels:
        site = self._site
        return UnlikelyLabels(TerrainTracer(site.open_dem(), site.curvature, site.refraction, site.possible_ground))

    def label(
        self, frame: PosedImage, covariance: Float64Array | None, in_order: bool = True
    ) -> tuple[Segmentation, SceneView]:
        """Label a frame. Return its labels and the scene view.

        `covariance`: (6, 6) of the frame's pose; None: it is exact. `in_order`: frames arrive in the order of their
        times, so that smoke is detected by comparison with previous ones; a single frame shows no smoke."""
        photo = frame.image
        view = self._scene.look(photo, Looking.of(frame.camera, frame.pose), frame.stamp_ns)
        if view.reason is None:
            unlikely = self._terrain.of(frame.camera, frame.pose, covariance)
            found = self.segmenter.segment(view.scene(photo), unlikely)
        else:
            found = Segmentation(np.zeros(photo.shape[:2], np.uint8), np.zeros(photo.shape[:2], np.uint8))
        view.unlabelled(found.labels, found.confidence)
        if self._smoke is None or not in_order or view.reason is not None:
            return found, view
        smoke = self._smoke.look(photo, found.labels, frame.stamp_ns * 1e-9)
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
        limits = GroundLimits(site.fuel.steepest_deg, self.geometry, dem, self.labels)
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
        return fitting(votes)
