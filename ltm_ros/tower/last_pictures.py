"""Keep the last complete frame of each camera and the map as small images, while the status page is open.

A subscription to images makes the nodes send them, which costs processor time for each frame. So the node subscribes to
a camera's images only until one frame is complete, at the start and for `WATCHED_S` after each request."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from rclpy.node import Node

from ltm_core.base.errors import LtmError
from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.resources import config_path
from ltm_core.base.types import Float32Array, RgbImage, UInt8Array
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pictures.legend import (
    UNLABELLED,
    ClassPalette,
    Palette,
    depth_colors,
    label_legend,
    metres,
    to_jpeg,
    to_png,
)
from ltm_core.pictures.maps import MapCamera, cells_under, finished, furnished, interesting_bounds, view_of
from ltm_core.pictures.photo_overlays import label_colors, overlay_depth, overlay_labels
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.image import msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime import topics
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.stamp_join import StampJoin
from ltm_ros.runtime.topics import camera_topic, site_topic
from ltm_ros.tower.live_stream import KINDS

WIDTH = 800
"""Maximum width of an image in pixels, without the photo in full size."""
SMALL_QUALITY = 60
"""JPEG quality for slow connections."""
RECENT = 12
"""Number of images of a camera, the newest, in which a user can still set a mark."""
_GREY = (205, 208, 212)


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """One frame with its results: `photo` (H, W, 3), `labels` (H, W), `depth` (H, W) metres; `full`: JPEG of the photo
    in full size."""

    name: str
    stamp_ns: int
    photo: RgbImage
    labels: UInt8Array
    depth: Float32Array
    camera: Camera
    pose: Pose
    full: bytes = b""

    def small(self) -> "CameraPicture":
        """Return a copy at most `WIDTH` pixels wide, with the photo in full size as JPEG."""
        small = self.resized(WIDTH)
        return self if small is self else replace(small, full=to_jpeg(self.photo))

    def pixel(self, across: float, down: float) -> tuple[float, float]:
        """Return (u, v) in the camera's full image; `across` and `down` are shares of its width and height."""
        width, height = self.camera.width, self.camera.height
        return min(max(across * width - 0.5, 0.0), width - 1.0), min(max(down * height - 0.5, 0.0), height - 1.0)

    def resized(self, width: int) -> "CameraPicture":
        """Return it at most `width` pixels wide."""
        rows, columns = self.photo.shape[:2]
        if columns <= width:
            return self
        size = width, max(1, round(rows * width / columns))
        photo = np.asarray(cv2.resize(self.photo, size, interpolation=cv2.INTER_AREA), np.uint8)
        labels, depth = (cv2.resize(one, size, interpolation=cv2.INTER_NEAREST) for one in (self.labels, self.depth))
        return replace(self, photo=photo, labels=np.asarray(labels, np.uint8), depth=np.asarray(depth, np.float32))

    def jpeg(self, kind: str, palette: ClassPalette, quality: int = 85) -> bytes:
        """Return a JPEG of `kind`: photo, full (its full size), labels or depth. Raises ImageError if sizes differ."""
        if kind == "full" and self.full:
            return self.full
        if kind == "labels":
            return to_jpeg(overlay_labels(self.photo, self.labels, palette), quality)
        if kind == "depth":
            return to_jpeg(overlay_depth(self.photo, self.depth), quality)
        return to_jpeg(self.photo, quality)

    @property
    def on_map(self) -> MapCamera:
        """Return the camera with a sector as long as 95 % of its depths are."""
        x, y, _ = self.pose.position
        known = self.depth[np.isfinite(self.depth)]
        reach = float(np.percentile(known, 95)) if known.size else 1000.0
        return MapCamera(self.name, self.camera, (float(x), float(y)), self.pose.angles_deg[0], reach)


WATCHED_S = 60.0
WAITING = 3
"""Maximum number of incomplete frames of a camera."""


class LastPictures:
    """`look` and the images may be requested from any thread; the rest runs in the node's executor."""

    def __init__(self, node: Node, site: Site, cameras: Sequence[str], health: Health) -> None:
        self._node, self._site, self._health = node, site, health
        self._labels = LabelSet.load(config_path(site.labels))
        self._map_palette = life_form_labels(self._labels)
        self._cameras = {name: _CameraFrames(node, site, name, health, self._keep) for name in cameras}
        self._kept: dict[str, CameraPicture] = {}
        self._recent: dict[str, deque[CameraPicture]] = {name: deque(maxlen=RECENT) for name in cameras}
        ranges = (30.0, 100.0, 300.0, 1000.0, 3000.0, 10_000.0, 30_000.0)
        shades = depth_colors(np.array(ranges)).tolist()
        self.legends = {
            "labels": list(zip(self._labels.names, self._labels.colors, strict=True)),
            "depth": list(zip(map(metres, ranges), shades, strict=True)),
        }
        """Names and colours of what the page lays over photos."""
        self._map: Any = None
        self._looked_s = -float("inf")
        self._lock = threading.Lock()
        node.create_subscription(
            topics.FUEL_MAP.type,
            site_topic(site.name, topics.FUEL_MAP),
            self._keep_map,
            stream_qos(topics.FUEL_MAP.latched, topics.FUEL_MAP.depth),
        )

    def look(self) -> None:
        self._looked_s = time.monotonic()

    def tick(self) -> None:
        """Start and stop subscriptions; call it about once a second, in the executor."""
        watched = time.monotonic() - self._looked_s < WATCHED_S
        for name, camera in self._cameras.items():
            camera.listen(watched or name not in self._kept)

    def stamps_s(self) -> dict[str, float]:
        """Return the stamps of the frames that have images, in seconds."""
        with self._lock:
            return {name: picture.stamp_ns / 1e9 for name, picture in self._kept.items()}

    def shown(self, camera: str, stamp_s: float | None = None) -> CameraPicture | None:
        """Return the newest frame, or one of the last of this stamp, without pixels; None if there is none."""
        with self._lock:
            if stamp_s is None:
                return self._kept.get(camera)
            # A browser's numbers hold microseconds.
            return next((one for one in self._recent[camera] if abs(one.stamp_ns / 1e9 - stamp_s) < 1e-3), None)

    def jpeg(self, camera: str, kind: str) -> bytes | None:
        """Return a JPEG; None if no frame has come. Raises ImageError."""
        picture = self.shown(camera)
        return picture.jpeg(kind, self._labels) if picture is not None else None

    def jpegs(self, picture: CameraPicture, width: int) -> list[bytes]:
        """Return the JPEGs of all kinds, at most `width` pixels wide. Raises ImageError."""
        small = picture.resized(width)
        return [small.jpeg(kind, self._labels, SMALL_QUALITY) for kind in KINDS]

    def map_png(self, places: Sequence[tuple[int, float, float]] = ()) -> bytes | None:
        """Return the part of the life form map that the cameras see, or all that is known without cameras, with places
        (number, longitude, latitude), a scale bar with a note, and a legend, as PNG; None if no map has come. Raises
        MessageError."""
        with self._lock:
            message, cameras = self._map, [picture.on_map for picture in self._kept.values()]
        if message is None:
            return None
        classes, geometry = msg_to_classes(message)
        known = (classes != UNLABELLED) & (not cameras)
        seen = np.concatenate([camera.sector() for camera in cameras]).tolist() if cameras else ()
        view = view_of(interesting_bounds(known, geometry, seen, geometry), WIDTH)
        row, col, inside = cells_under(geometry, view)
        ids, palette = np.where(inside, classes[row, col], np.uint8(UNLABELLED)), self._map_palette
        picture = label_colors(ids, palette, unlabelled=_GREY)
        lines = np.zeros(ids.shape, np.bool_)
        lines[:, 1:] |= ids[:, 1:] != ids[:, :-1]
        lines[1:] |= ids[1:] != ids[:-1]
        picture[lines] = (picture[lines] * 0.85).astype(np.uint8)
        shown = Palette((*palette.names, "not known"), (*palette.colors, _GREY))
        found = [len(shown.names) - 1 if label == UNLABELLED else label for label in np.unique(ids).tolist()]
        for number, lon, lat in places:
            x, y = self._site.frame.from_lonlat(lon, lat)
            cameras.append(MapCamera(f"place {number}", None, (float(x), float(y))))
        stamp = stamp_of(message)
        dated = f"as of {moment_of_stamp(stamp):%Y-%m-%d %H:%M} UTC" if stamp else "prior map, nothing seen"
        legend, note = label_legend(WIDTH, shown, found), f"{self._site.crs}, {dated}"
        return to_png(finished(furnished(picture, view, cameras), view, legend, note=note))

    def _keep(self, picture: CameraPicture) -> None:
        none = np.zeros((0, 0), np.uint8)  # marks need no pixels
        small = replace(picture, photo=none[..., None], labels=none, depth=none.astype(np.float32), full=b"")
        with self._lock:
            self._kept[picture.name] = picture
            self._recent[picture.name].append(small)

    def _keep_map(self, message: Any) -> None:
        with self._lock:
            self._map = message


class _CameraFrames:
    """Subscription to one camera's frames, on or off."""

    def __init__(
        self, node: Node, site: Site, name: str, health: Health, keep: Callable[[CameraPicture], None]
    ) -> None:
        self._node, self._site, self._name, self._health, self._keep = node, site, name, health, keep
        self._topics = {
            "image": topics.POSED_IMAGE,
            "labels": topics.LABELS_IMAGE,
            "depth": topics.FUSED_DEPTH if site.depth_model else topics.DEPTH_IMAGE,
            "info": topics.DEPTH_CAMERA_INFO,
            "pose": topics.POSED_POSE,
        }
        # Other nodes report invalid frames; here an incomplete frame is only not shown.
        self._join = StampJoin(tuple(self._topics), self._whole, health, WAITING, give_up=lambda *_: None)
        self._subscriptions: list[Any] = []

    def listen(self, wanted: bool) -> None:
        self._join.tick(1.0)
        if not wanted:
            for subscription in self._subscriptions:
                self._node.destroy_subscription(subscription)
            self._subscriptions.clear()
        elif not self._subscriptions:
            self._subscriptions = [
                self._node.create_subscription(
                    topic.type,
                    camera_topic(self._site.name, self._name, topic),
                    partial(self._take, part),
                    stream_qos(False, WAITING),
                )
                for part, topic in self._topics.items()
            ]

    def _take(self, part: str, message: Any) -> None:
        try:
            self._join.add(part, stamp_of(message), message)
        except LtmError as error:
            self._health.drop(cause_of(error), str(error))

    def _whole(self, image: Any, labels: Any, depth: Any, info: Any, pose: Any) -> None:
        photo, classes = msg_to_rgb(image), msg_to_array(labels, ("mono8",))
        metres_, camera, posed = msg_to_depth(depth), msg_to_camera(info), msg_to_pose(pose, "map")
        self._keep(CameraPicture(self._name, stamp_of(image), photo, classes, metres_, camera, posed).small())
