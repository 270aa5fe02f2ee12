"""Read photos with their views: of a recording as the graph joins them, or of a folder by the site's cameras."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.storage.image_io import read_rgb
from ltm_core.visibility.viewshed import PosedCamera
from ltm_lab.simulator.real_site import views_of
from ltm_msgs_py.bag.reader import is_bag_file
from ltm_msgs_py.image import msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.recordings.replay.offline import OfflineGraph, Selection
from ltm_ros.runtime.topics import POSED_CAMERA_INFO, POSED_IMAGE, POSED_POSE

_PHOTOS = (".jpg", ".jpeg", ".png")
_PARTS = (POSED_IMAGE.name, POSED_CAMERA_INFO.name, POSED_POSE.name)


Posed = tuple[str, PosedCamera, UInt8Array]
"""Name of a photo, its view in the map frame, and its pixels (H, W, 3)."""


class _Posing(OfflineGraph):
    """Runs the nodes that give photos a pose; `ready` holds the photos since it was emptied."""

    def __init__(self, graph: Graph) -> None:
        self.ready: list[Posed] = []
        self._parts: dict[tuple[str, int], dict[str, Any]] = {}
        super().__init__(graph)

    def publish(self, topic: str, message: Any, latched: bool = False) -> None:
        part = next((name for name in _PARTS if topic.endswith(f"/{name}")), None)
        if part is not None:
            key = place, stamp = topic.removesuffix(f"/{part}"), stamp_of(message)
            parts = self._parts.setdefault(key, {})
            parts[part] = message
            if len(parts) == len(_PARTS):
                image, camera, pose = (parts[name] for name in _PARTS)
                name = place.rpartition("/")[2]
                view = PosedCamera(name, msg_to_camera(camera), msg_to_pose(pose))
                self.ready.append((f"{name}_{stamp}", view, msg_to_rgb(image)))
                del self._parts[key]
        super().publish(topic, message, latched)

    def listened(self, topic: str) -> bool:
        return topic.endswith(_PARTS) or super().listened(topic)


def photos_with_views(photos: Path, site: Site, site_file: Path, dem: Dem, limit: int | None) -> Iterator[Posed]:
    """Yield the photos of a recording in order of time, or those of a folder by camera, at most `limit`.

    Raises RecordingError or ConfigError if there is none with a pose and a calibration.
    """
    if is_bag_file(photos.name) or any(is_bag_file(path.name) for path in photos.glob("*")):
        found = _of_recording(photos, site, site_file)
    else:
        found = _of_folder(photos, views_of(site, dem))
    yield from islice(found, limit)


def _of_recording(bag: Path, site: Site, site_file: Path) -> Iterator[Posed]:
    selection = Selection.open(bag, site, 0.0, None)
    whole = describe(site, site_file)
    posing = _Posing(Graph(whole.site, tuple(node for node in whole if node.executable == "capture")))
    found = False
    for message, content in selection.decoded():
        posing.feed(message.topic, content, message.log_time_ns)
        found = found or bool(posing.ready)
        yield from posing.ready
        posing.ready.clear()
    posing.finish()
    yield from posing.ready
    if not found and not posing.ready:
        raise RecordingError(f"{bag}: no photo has a pose and a calibration; see `ltm replay {bag} --offline`")


def _of_folder(folder: Path, views: Sequence[PosedCamera]) -> Iterator[Posed]:
    named = photos_of(folder, [view.name for view in views])
    for view in views:
        for number, path in enumerate(named[view.name]):
            yield f"{view.name}_{number:04d}", view, read_rgb(path)


def photos_of(folder: Path, cameras: Sequence[str]) -> dict[str, list[Path]]:
    """Return the photos below a folder by camera. A photo is of the camera with whose name its file or its subfolder
    begins; if the site has one camera, all are of it. Raises ConfigError if there are none."""
    found: dict[str, list[Path]] = {name: [] for name in cameras}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in _PHOTOS:
            parts = (*path.relative_to(folder).parts[:-1], path.stem)
            names = [name for name in cameras if any(part.startswith(name) for part in parts)]
            chosen = max(names, key=len, default=cameras[0] if len(cameras) == 1 else None)
            if chosen is not None:
                found[chosen].append(path)
    if not any(found.values()):
        raise ConfigError(f"{folder}: has no photo of {', '.join(cameras)}; name files or subfolders by camera")
    return found
