"""The topics of the graph. Names are relative to `/<site>/<camera>/` or, under SITE, to `/<site>/`."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PolygonStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, NavSatFix, PointCloud2
from std_msgs.msg import String

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.schemas import message_class
from ltm_ros.runtime.handler import Topic

if TYPE_CHECKING:
    from ltm_core.site.sections import CameraConfig
    from ltm_core.site.site import Site

IMAGE_RAW = Topic("image_raw", Image)
IMAGE_COMPRESSED = Topic("image_raw/compressed", CompressedImage)
CAMERA_INFO = Topic("camera_info", CameraInfo)
POSE = Topic("pose", PoseWithCovarianceStamped)
FIX = Topic("fix", NavSatFix, counted=False)
IMU = Topic("imu", Imu, depth=100, counted=False)  # some phones send two hundred a second
"""Sensor from which a camera's pose is computed if its site file enables it (`sensors`)."""

try:
    _TF: type | None = message_class("tf2_msgs/msg/TFMessage")
except RecordingError:  # its package has no wheel
    _TF = None
TF = None if _TF is None else Topic("/tf", _TF, depth=100, counted=False)
TF_STATIC = None if _TF is None else Topic("/tf_static", _TF, latched=True, depth=100, counted=False)
"""Transforms from `map` to each camera's link and optical frame (REP-105), if the package tf2_msgs is installed."""

SOURCE_INFO = Topic("source/info", DiagnosticArray, latched=True)
"""Uncertainty of a frame's stamp, its source, and whether this computer's clock was synchronised."""

POSED_IMAGE = Topic("posed/image", Image)
POSED_CAMERA_INFO = Topic("posed/camera_info", CameraInfo)
POSED_POSE = Topic("posed/pose", PoseWithCovarianceStamped)
POSED_FIX = Topic("posed/fix", NavSatFix, counted=False)
"""Place of the camera, for maps."""
STATED_POSE = Topic("posed/stated_pose", PoseWithCovarianceStamped)
"""Pose as received, for frames whose poses are refined."""
POSE_CORRECTION = Topic("pose/correction", PoseWithCovarianceStamped, latched=True)
"""Rotation about the map's axes that corrects stated poses, and the covariance of their angles after it."""
POSE_INFO = Topic("pose/info", DiagnosticArray, latched=True)

DEPTH_IMAGE = Topic("depth/image", Image)
DEPTH_CAMERA_INFO = Topic("depth/camera_info", CameraInfo)
GROUND_DEPTH = Topic("depth/ground", Image)
ALIGNMENT = Topic("alignment", Image)
DEPTH_INFO = Topic("depth/info", DiagnosticArray)
"""Version of the confirmed surface that a frame was traced to, if the site uses it."""

FUSED_DEPTH = Topic("fused/depth", Image)
FUSED_SIGMA = Topic("fused/sigma", Image)
FUSED_SOURCE = Topic("fused/source", Image)
FUSED_INFO = Topic("fused/info", DiagnosticArray)
NETWORK_DEPTH = Topic("network/depth", Image)
MEASURED_DEPTH = Topic("measured/depth", Image)
MEASURED_SIGMA = Topic("measured/sigma", Image)

LABELS_IMAGE = Topic("labels/image", Image)
LABELS_CONFIDENCE = Topic("labels/confidence", Image)
LABELS_INFO = Topic("labels/info", String, latched=True)

LABELS_HEAT = Topic("labels/heat", Image)
"""Probability of the prompt on PROMPT x 255 for each pixel. It never votes."""
PROMPT = Topic("prompt", String)
"""Prompt of an operator, for all cameras of the site; empty: none."""

FUEL_VOTES = Topic("fuel/votes", PointCloud2)

FUEL_MAP = Topic("fuel_map", OccupancyGrid, latched=True)
FUEL_MAP_UPDATE = Topic("fuel_map/update", OccupancyGrid, depth=200)  # they come in bursts, twice a second
FUEL_MAP_INFO = Topic("fuel_map/info", String, latched=True)
FUEL_MAP_QUERY = Topic("fuel_map/query", PointStamped)
FUEL_MAP_ANSWER = Topic("fuel_map/answer", String, latched=True)
FUEL_MAP_REGION = Topic("fuel_map/region", PolygonStamped)
FUEL_MAP_CELLS = Topic("fuel_map/cells", PointCloud2, latched=True)

TERRAIN_UPDATE = Topic("terrain/update", PointCloud2)
TERRAIN_CHANGE = Topic("terrain/change", OccupancyGrid, latched=True)
TERRAIN_INFO = Topic("terrain/info", String, latched=True)
TERRAIN_SURFACE = Topic("terrain/surface", DiagnosticArray, latched=True, counted=False)
"""Version of the confirmed surface to which depth is traced from then on."""

LOCATE_REGION = Topic("locate/region", PolygonStamped)
LOCATE_POINT = Topic("locate/point", PointStamped)
LOCATE_ESTIMATE = Topic("locate/estimate", PoseWithCovarianceStamped)
LOCATE_FIX = Topic("locate/fix", NavSatFix)
LOCATE_AREA = Topic("locate/area", PolygonStamped)
LOCATE_FUSED = Topic("locate/fused", PoseWithCovarianceStamped)
LOCATE_TRACKS = Topic("locate/tracks", String, latched=True)
"""Marks in a camera's image, by a detector or a person; their places; and the site's tracks."""

TRUTH_DEPTH = Topic("truth/depth", Image)
TRUTH_GROUND_DEPTH = Topic("truth/ground_depth", Image)
TRUTH_LABELS = Topic("truth/labels", Image)
TRUTH_CAMERA_INFO = Topic("truth/camera_info", CameraInfo)
TRUTH_POSE = Topic("truth/pose", PoseWithCovarianceStamped)

CAMERA_INPUTS = (IMAGE_RAW, IMAGE_COMPRESSED, CAMERA_INFO, POSE, FIX, IMU)
"""Topics that a recording needs so that the graph can run on it."""
CAMERA_TRUTH = (TRUTH_DEPTH, TRUTH_GROUND_DEPTH, TRUTH_LABELS, TRUTH_CAMERA_INFO, TRUTH_POSE)
"""Additional topics of a simulated recording; no node of the graph uses them."""

_RECORDED_OF_CAMERA = (
    *(*CAMERA_INPUTS, *CAMERA_TRUTH, SOURCE_INFO, POSED_POSE, POSED_FIX, POSE_CORRECTION, POSE_INFO),
    *(DEPTH_IMAGE, DEPTH_CAMERA_INFO, DEPTH_INFO, FUSED_DEPTH, FUSED_INFO, NETWORK_DEPTH, LABELS_IMAGE, LABELS_INFO),
    *(FUEL_VOTES, LOCATE_REGION, LOCATE_POINT, LOCATE_ESTIMATE, LOCATE_FIX, LOCATE_AREA),
)
_RECORDED_OF_SITE = (
    *(FUEL_MAP, FUEL_MAP_UPDATE, FUEL_MAP_INFO, TERRAIN_UPDATE, TERRAIN_CHANGE, TERRAIN_INFO, TERRAIN_SURFACE),
    *(LOCATE_FUSED, LOCATE_TRACKS),
)
RECORDED = _RECORDED_OF_CAMERA, _RECORDED_OF_SITE
"""Topics that are recorded by default, of each camera and of the site: all except decoded copies of images."""


def camera_topic(site: str, camera: str, topic: Topic) -> str:
    """Return a camera topic's absolute name."""
    return topic.under(f"/{site}/{camera}")


def input_topic(camera: "CameraConfig", topic: Topic) -> Topic:
    """Return a topic under the name that the site file gives it, if any. Named poses may have any rate and type;
    transforms become poses on the usual topic."""
    name = getattr(camera.topics, "image" if topic in (IMAGE_RAW, IMAGE_COMPRESSED) else topic.name, None)
    if not name:
        return topic
    if topic is not POSE:
        return replace(topic, name=name, usual_name=topic.name)
    if transform_topics(camera)[0]:
        return replace(topic, counted=False)
    return replace(topic, name=name, usual_name=topic.name, counted=False, any_pose=True)


def transform_topics(camera: "CameraConfig") -> tuple[str, str]:
    """Return the topics of moving transforms, if the site file names them as the camera's pose, and of static ones."""
    name = camera.topics.pose or ""
    moving = name if name.endswith("/tf") else ""
    return moving, f"{moving or '/tf'}_static"


def image_topics(camera: "CameraConfig") -> tuple[Topic, ...]:
    """Return the image topics of a camera; `auto` takes both kinds, the preferred one first, unless the name of the
    topic or the camera's source decides."""
    kind, name = camera.image, camera.topics.image
    if kind == "auto" and name is not None:
        kind = "compressed" if name.endswith("/compressed") else "raw"
    if kind == "auto" and camera.source is None:
        return IMAGE_COMPRESSED, IMAGE_RAW
    return (input_topic(camera, IMAGE_RAW if kind == "raw" else IMAGE_COMPRESSED),)


def other_inputs(camera: "CameraConfig") -> tuple[Topic, ...]:
    """Return the other topics whose messages are joined to a camera's images, as the site file leaves them open."""
    calibration = () if camera.calibration is not None else (CAMERA_INFO,)
    pose = (FIX, IMU) if camera.sensors is not None else () if camera.pose is not None else (POSE,)
    return tuple(input_topic(camera, topic) for topic in (*calibration, *pose))


def site_topic(site: str, topic: Topic) -> str:
    """Return a site topic's absolute name."""
    return f"/{site}/{topic.name}"


def of_camera(site: str, camera: str, topic: Topic) -> Topic:
    """Return a camera topic under its absolute name, for nodes of the whole site."""
    return replace(topic, name=camera_topic(site, camera, topic))


def of_cameras(site: "Site", takes: Mapping[Topic, Callable[[str, Any], None]]) -> dict[Topic, Callable[[Any], None]]:
    """Return topics of all cameras of a site under their absolute names, with callbacks that take the camera's name and
    the message."""
    return {
        of_camera(site.name, name, topic): partial(take, name) for name in site.cameras for topic, take in takes.items()
    }


def of_site(site: str, topic: Topic) -> Topic:
    """Return a site topic under its absolute name, for nodes of a camera."""
    return replace(topic, name=site_topic(site, topic))
