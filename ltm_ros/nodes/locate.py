"""locate: find the places on the map of marks that a detector or a person sets in camera images."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError, MessageError
from ltm_core.base.types import Float64Array
from ltm_core.fuel.prior import FuelPrior, load_prior
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.locating.answer import LocateResult, answer, as_geojson
from ltm_core.locating.locator import Location, Locator
from ltm_core.locating.region import marked_pixel, marked_polygon
from ltm_core.locating.sighting import Sighting
from ltm_core.locating.tracks import KnownPoses, SeenAt, Tracks
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site_io import load_site
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.masks import Looking
from ltm_msgs_py.json_topics import LocateTracks
from ltm_msgs_py.pose import (
    msg_to_covariance,
    msg_to_outline,
    msg_to_pose,
    outline_to_msg,
    place_to_msg,
)
from ltm_msgs_py.sensors import msg_to_camera, place_to_fix
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import Handler, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health, too_many_pixels
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_check import StampCheck, StampLimits
from ltm_ros.runtime.topics import of_camera, of_cameras

_OF_CAMERAS = topics.LOCATE_ESTIMATE, topics.LOCATE_FIX, topics.LOCATE_AREA


class LocateConfig(StampLimits):
    smoke: bool = True
    """Whether the marks are smoke, whose base may be hidden; otherwise the object stands on the marked ground."""
    pose_age: float = Field(120.0, gt=0)
    """Maximum age in seconds of a camera's pose for a region without a pose of equal stamp."""
    track_lifetime: float = Field(3600.0, gt=0)
    """Seconds without a new sighting after which a track ends."""
    max_tracks: int = Field(16, ge=1, le=100)
    """Maximum number of tracks; the one seen longest ago is dropped first."""


class LocateHandler(Handler[LocateConfig]):
    """Publishes the place of each region in its camera's namespace, and keeps the site's tracks."""

    def __init__(self, config: LocateConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        self._site = site = load_site(config.site)
        if site.locating is None:
            raise ConfigError(f"{config.site}: has no section `locating`; add one (`locating: {{}}` uses the defaults)")
        ground = site.open_dem()
        dem = site.open_surface(ground)
        self._locator = Locator(dem, site.bend, site.locating)
        self._sight = PointVisibility(dem, site.curvature, site.refraction, site.possible_ground)
        self._prior: FuelPrior | None = None
        if site.fuel.prior is not None:
            grid = site.fuel_geometry(ground)
            read = load_prior(site.fuel.prior, site.in_crs(grid))
            self._prior = FuelPrior(read.codes, grid, read.system)
        self._assumed = site.assumed_pose_error.covariance()
        self._stamps = StampCheck(outlet.now_ns, health, config.max_ahead, config.max_behind)
        lifetime = round(config.track_lifetime * 1e9)
        self._tracks = Tracks(self._locator, config.smoke, lifetime, config.max_tracks)
        self._scenes = {name: site_scene_filter(site, name) for name in site.cameras}
        self._cameras: dict[str, Camera] = {}
        self._poses = {name: KnownPoses() for name in site.cameras}
        self._own = {(name, topic): of_camera(site.name, name, topic) for name in site.cameras for topic in _OF_CAMERAS}
        self.publications = (*self._own.values(), topics.LOCATE_FUSED, topics.LOCATE_TRACKS)

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        takes: dict[Topic, Callable[[str, Any], None]] = {
            topics.POSED_CAMERA_INFO: self.on_camera_info,
            topics.POSED_POSE: self.on_pose,
            topics.LOCATE_REGION: lambda name, message: self.on_region(name, "detector", message),
            topics.LOCATE_POINT: lambda name, message: self.on_region(name, "person", message),
        }
        return of_cameras(self._site, takes)

    def start(self) -> None:
        compile_kernels("locate", self._site)
        self._publish_tracks(0)

    def on_camera_info(self, name: str, message: Any) -> None:
        camera, most = msg_to_camera(message), self._site.limits.pixels
        if not too_many_pixels(self.health, f"calibration of {name}", camera.width, camera.height, most):
            self._cameras[name] = camera

    def on_pose(self, name: str, message: Any) -> None:
        covariance = msg_to_covariance(message, self._assumed)
        assert covariance is not None  # nosec B101 # tells the type checker what holds
        self._poses[name].add(stamp_of(message), msg_to_pose(message, "map"), covariance)

    def on_region(self, name: str, source: str, message: Any) -> None:
        outline = msg_to_outline(message, f"{name}_optical")
        stated = stamp_of(message)
        if stated and self._stamps.refuses(f"a region of {name}", stated):
            return
        pose, covariance, stamp = self._pose_at(name, stated)
        if not stated and self._stamps.refuses(f"the pose for a region of {name} without a stamp", stamp):
            return
        config, camera, smoke = self._locator.config, self._cameras.get(name), self.config.smoke
        if camera is None:
            missing = topics.POSED_CAMERA_INFO.name
            raise MessageError(f"a region of {name}, whose calibration has not been received: {missing}")
        hidden = self._scenes[name].hidden(camera.width, camera.height, Looking.of(camera, pose))
        if len(outline) == 1:
            mark = marked_pixel(camera, outline[0], config.pixel_sigma, hidden)
        else:
            mark = marked_polygon(camera, outline, config.pixel_sigma, config.box_sigma, smoke, hidden)
        seen = SeenAt(Sighting(name, camera, pose, covariance, mark), stamp, source)
        track, alone = self._tracks.add(seen)
        said = self._said(alone)
        fix = place_to_fix(said.name.lon, said.name.lat, alone.posterior.covariance, stamp, "map")
        area = outline_to_msg(said.ellipses[-1].outline(), stamp)
        for topic, sent in zip(_OF_CAMERAS, (_place_msg(said, stamp), fix, area), strict=True):
            self.outlet.publish(self._own[name, topic], sent)
        if track.disputed:
            self.health.note("cameras_disagree")
        self.health.gauge("tracks", len(self._tracks.tracks))
        self.outlet.publish(topics.LOCATE_FUSED, _place_msg(self._said(track.location), stamp))
        self._publish_tracks(stamp)

    def _pose_at(self, name: str, stamp: int) -> tuple[Pose, Float64Array, int]:
        """Return the pose of a stamp, or the last before it; for stamp 0, the newest. Raises MessageError
        without one."""
        poses = self._poses[name]
        if not poses:
            raise MessageError(f"a region of {name}, whose pose has not been received: {topics.POSED_POSE.name}")
        if stamp == 0:
            return poses.newest
        known = poses.at(stamp, round(self.config.pose_age * 1e9))
        if known is None:
            raise MessageError(
                f"a region of {name} of stamp {stamp} ns: no pose at this time, or up to {self.config.pose_age:g} "
                "s before; send the stamp of the marked image"
            )
        return *known, stamp

    def _said(self, location: Location) -> LocateResult:
        known = ((name, self._cameras.get(name), poses) for name, poses in self._poses.items() if poses)
        cameras = [PosedCamera(name, camera, poses.newest[0]) for name, camera, poses in known if camera is not None]
        return answer(location, self._sight, self._site.frame, cameras, self._prior, self.config.smoke)

    def _publish_tracks(self, stamp: int) -> None:
        features: list[Any] = []
        for track in self._tracks.tracks:
            properties = {
                "track": track.number,
                "seen_by": track.cameras,
                "sources": track.sources,
                "first_ns": track.first_ns,
                "last_ns": track.last_ns,
                "disagrees": ", ".join(sorted(track.disputed)) or None,
                "marks": [_mark_data(seen.sighting) for seen in track.sightings],
            }
            features += as_geojson(self._said(track.location), self._site.frame, properties)["features"]
        collection = {"stamp_ns": stamp, "features": features}
        self.outlet.publish(topics.LOCATE_TRACKS, LocateTracks.model_validate(collection).to_msg())


def _mark_data(sighting: Sighting) -> dict[str, Any]:
    """Return the camera, its viewing direction, and the middle of a mark in its image."""
    u, v = sighting.mark.weights @ sighting.mark.pixels
    azimuth, pitch, _ = sighting.pose.angles_deg
    return {
        "camera": sighting.name,
        "u": round(float(u), 1),
        "v": round(float(v), 1),
        "azimuth_deg": round(azimuth, 3),
        "pitch_deg": round(pitch, 3),
    }


def _place_msg(said: LocateResult, stamp: int) -> Any:
    posterior, height = said.location.posterior, said.name.elevation
    variance = said.elevation_sigma**2 if height is not None else 1e9
    return place_to_msg(np.array([*posterior.mean, height or 0.0]), posterior.covariance, variance, stamp)


NODE = NodeType("locate", LocateConfig, LocateHandler)
run_node(NODE, __name__)
