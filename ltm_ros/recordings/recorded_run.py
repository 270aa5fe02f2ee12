"""Open a recorded run: bag, site, frames, votes and final map; read images of single cameras."""

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.resources import config_path, project_path
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.label_heads.labelled_frames import evenly
from ltm_core.site.site import Site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.mask_config import ViewMask
from ltm_core.vision.masks import Looking
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_ros.recordings.frame_stream import PARTS, FrameStream, StreamedFrame
from ltm_ros.recordings.inputs import InputReader, beside_expected, decoded_input
from ltm_ros.runtime.topics import CAMERA_INFO, FUEL_MAP, POSE, camera_topic, input_topic, site_topic

FUEL_TRUTH = "fuel_truth.tif"


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """Inputs and results of a frame: `photo` (H, W, 3), traced `depth`, `labels` and `fused` depth, (H, W) each."""

    camera_name: str
    stamp_ns: int
    camera: Camera
    pose: Pose
    photo: UInt8Array
    depth: Float32Array
    labels: UInt8Array
    fused: Float32Array | None = None


@dataclass(frozen=True)
class Recorded:
    """A bag with its site, the folder of its truth, and the raster of true class ids on the fuel grid."""

    bag: Path
    site_path: Path
    site: Site
    truth: Path
    life_forms: Path | None = None


def recorded_frames(bag: Path, site: Site) -> Iterator[RecordedFrame]:
    """Yield the frames of a recorded run with depth and labels, camera by camera, in time order.

    A frame is returned as soon as the bag has given all of it, so a bag of hours needs the memory of a few frames."""
    stream = FrameStream(bag, site)
    for camera in site.cameras:
        for frame in stream.frames(("depth_camera", "pose", "photo", "traced", "labels"), [camera]):
            parts = (frame.take(part) for part in ("depth_camera", "pose", "photo", "traced", "labels", "fused"))
            yield RecordedFrame(camera, frame.stamp_ns, *parts)


def site_of(bag: Path) -> Path:
    """Return the site file in or beside a bag, or the shipped one of its topics. Raises RecordingError."""
    folder = bag.resolve()
    for place in (folder, folder.parent, folder.parent.parent):
        if (place / "site.yaml").is_file():
            return place / "site.yaml"
    for name in sorted({topic.split("/")[1] for topic in BagReader(bag).topics() if topic.count("/") > 2}):
        for shipped in (f"bags/{name}/site.yaml", f"config/sites/{name}.yaml"):
            with suppress(LtmError):
                return project_path(shipped)
    raise RecordingError(f"{bag}: no site.yaml is in it or beside it; give the site file with --site")


def image_shape(frame: StreamedFrame, site: Site) -> tuple[int, int]:
    """Return rows and columns of a frame's image. Raises RecordingError if unknown."""
    camera: Camera | None = frame.take("camera") or frame.take("depth_camera")
    if camera is None and (calibration := site.cameras[frame.camera_name].calibration) is not None:
        camera = calibration.camera()
    if camera is None:
        what = f"frame {frame.stamp_ns} of {frame.camera_name} has no camera_info, and site {site.name} no calibration"
        raise RecordingError(f"{what}: record camera_info")
    return camera.height, camera.width


def recorded_votes(recorded: Recorded, geometry: GridGeometry, labels: LabelSet) -> Iterator[CellVotes]:
    """Yield the votes of a bag, frame by frame; `geometry`: the fuel grid in the map frame. Raises MessageError."""
    for frame in FrameStream(recorded.bag, recorded.site).frames(["votes"]):
        yield msg_to_votes(frame.take("votes"), geometry, labels.names, frame.camera_name)


def last_fuel_map(bag: Path, site: Site) -> tuple[UInt8Array, GridGeometry, LabelSet]:
    """Return class ids (255 unseen), geometry in the site's CRS, and labels. Raises RecordingError without a map."""
    reader = BagReader(bag)
    topic = site_topic(site.name, FUEL_MAP)
    last = next(iter(deque(reader.messages([topic]), 1)), None)
    if last is None:
        raise RecordingError(f"{bag} has no {topic}; its topics are {', '.join(sorted(reader.topics())) or '(none)'}")
    classes, geometry = msg_to_classes(reader.decode(last))
    return classes, site.in_crs(geometry), LabelSet.load(config_path(site.labels))


def recorded_pictures(
    bag: Path, site: Site, camera: str, most: int, view: ViewMask | None = None
) -> tuple[list[str], list[UInt8Array]]:
    """Return names by stamps, and images of a camera in a recording, `most` of them at most.

    `view`: only images with this viewing direction; the zoom does not matter. Raises RecordingError, ImageError."""

    def chosen(frame: StreamedFrame) -> bool:
        if view is None:
            return True
        azimuth, pitch, _ = frame.take("pose").angles_deg
        return Looking(azimuth, pitch, view.hfov_deg or 1.0).off_deg(view) <= view.within_deg

    site.camera(camera)
    stream = FrameStream(bag, site, {part: PARTS[part] for part in ("photo", "pose")}, [camera])
    if not stream.has("photo"):
        raise RecordingError(f"{bag}: no image of {camera}; its topics are {stream.topics}")
    needed = ("photo",) if view is None else ("photo", "pose")
    stamps = [frame.stamp_ns for frame in stream.frames(needed) if chosen(frame)]
    if view is not None and not stamps:
        raise RecordingError(f"{bag}: no image of {camera} has a pose in the direction of view {view.name}")
    wanted = set(evenly(stamps, most))
    frames = [(f.stamp_ns, f.take("photo")) for f in stream.frames(needed) if f.stamp_ns in wanted]
    return [f"{camera}_{stamp}" for stamp, _ in frames], [photo for _, photo in frames]


_MOST = 12
"""Maximum number of views per camera."""
_ALIKE_DEG = 2.0


def recorded_views(bag: Path, site: Site) -> list[PosedCamera]:
    """Return the different views of each recorded camera of the site, in order of time, at most _MOST per camera.

    Raises RecordingError if there are none at all."""
    reader = BagReader(bag)
    inputs = InputReader(reader, site)
    owners = {
        camera_topic(site.name, name, topic): name
        for name, config in site.cameras.items()
        for topic in (input_topic(config, CAMERA_INFO), input_topic(config, POSE), POSE)
    }
    cameras: dict[str, Camera] = {}
    poses: dict[str, list[Pose]] = {name: [] for name in site.cameras}
    for message in inputs.messages([name for name in inputs.topics if name in owners]):
        camera, topic = owners[message.topic], inputs.topics[message.topic]
        with suppress(LtmError):  # a replay counts what is damaged
            content = decoded_input(topic, message.raw, message.type_name, message.encoding)
            if topic.counted_name == POSE.name:
                pose = msg_to_pose(content, "map")
                if len(poses[camera]) < _MOST and not any(_alike(pose, other) for other in poses[camera]):
                    poses[camera].append(pose)
            elif camera not in cameras:
                cameras[camera] = msg_to_camera(content)
    for name, config in site.cameras.items():
        if config.calibration is not None:
            cameras[name] = config.calibration.camera()
    views = [PosedCamera(name, cameras[name], pose) for name in cameras for pose in poses[name]]
    if not views:
        what = f"{bag}: no camera_info and pose of the cameras of {site.name} ({', '.join(site.cameras)})"
        raise RecordingError(f"{what}; {beside_expected(site, reader.topics())}")
    return views


def _alike(pose: Pose, other: Pose) -> bool:
    (azimuth, pitch, _), (azimuth_of_other, pitch_of_other, _) = pose.angles_deg, other.angles_deg
    turned = abs((azimuth - azimuth_of_other + 180) % 360 - 180)
    return turned < _ALIKE_DEG and abs(pitch - pitch_of_other) < _ALIKE_DEG
