"""source: request images from a camera and publish them with time and direction, like a driver."""

from collections.abc import Sequence

from ltm_core.base.errors import ConfigError
from ltm_core.site.site_io import load_site
from ltm_core.storage.image_io import image_format
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.status import status_to_msg
from ltm_ros.cameras.camera_source import Frame
from ltm_ros.cameras.opening import SourceThread, source_of
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, IMAGE_RAW, POSE, SOURCE_INFO

JPEG_QUALITY = 92
"""JPEG quality of video images, if the camera sends no JPEGs."""


class SourceHandler(Handler[NodeConfig]):
    """Requests and publishes images in a separate thread (`SourceThread`), as the site file configures it
    (`cameras: NAME: source`)."""

    publications: Sequence[Topic] = (IMAGE_COMPRESSED, CAMERA_INFO, POSE, SOURCE_INFO)

    def __init__(self, config: NodeConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        camera = site.camera(config.camera)
        if camera.source is None:
            raise ConfigError(f"camera {config.camera} of site {site.name} has no section source")
        self._raw = camera.image == "raw"
        if self._raw:
            self.publications = (IMAGE_RAW, CAMERA_INFO, POSE, SOURCE_INFO)
        self._frame_id = f"{config.camera}_optical"
        self._source = source_of(site, config.camera, camera.source, self._publish, health)
        self._source.report()
        self._ended = False
        activity = HEARTBEAT.activity(f"source {config.camera}")
        self._thread = SourceThread(config.camera, self._source, health, activity)

    def start(self) -> None:
        self._thread.start()

    def tick(self, waited: float) -> None:
        self._source.report()

    def finish(self) -> None:
        self._ended = True
        self._thread.stop()

    def _publish(self, frame: Frame) -> None:
        if self._ended:
            return  # the node may end before a slow camera has answered
        stamp = frame.stamp_ns
        self.outlet.publish(CAMERA_INFO, camera_to_msg(frame.camera, stamp, self._frame_id))
        if frame.pose is not None:
            self.outlet.publish(POSE, pose_to_msg(frame.pose, stamp, "map", frame.covariance))
        said: dict[str, object] = {
            "uncertainty_s": round(frame.uncertainty, 4),
            "told_by": frame.told_by,
            "synchronised": frame.synchronised,
        }
        name, wrong = f"{self.config.camera}/source", frame.synchronised is False
        self.outlet.publish(SOURCE_INFO, status_to_msg(name, stamp, said, wrong=wrong))
        if self._raw and frame.rgb is not None:
            self.outlet.publish(IMAGE_RAW, image_to_msg(frame.rgb, "rgb8", stamp, self._frame_id))
            return
        data = frame.jpeg or b"" if frame.rgb is None else encode_rgb(frame.rgb, "jpeg", JPEG_QUALITY)
        self.outlet.publish(IMAGE_COMPRESSED, compressed_to_msg(data, image_format(data), stamp, self._frame_id))


NODE = NodeType("source", NodeConfig, SourceHandler)
run_node(NODE, __name__)
