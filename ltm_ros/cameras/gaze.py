"""Choose how a source learns the viewing direction and lens of its camera: from the site file or from a PTZ head."""

from __future__ import annotations

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.mount.mount_config import MountConfig
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.site.ptz_config import PtzConfig
from ltm_core.site.sections import CameraConfig
from ltm_core.site.site import Site
from ltm_core.site.source_config import SourceConfig
from ltm_ros.cameras.camera_source import Gaze
from ltm_ros.cameras.protocols.direction import PtzReading, Tolerance
from ltm_ros.cameras.ptz.head import PtzDirection, PtzPatrol, tolerance_of
from ltm_ros.cameras.ptz.opening import open_ptz


class MountPoses:
    """The `PoseModel` of a PTZ head on its mount."""

    def __init__(self, model: MountModel, tolerance: Tolerance) -> None:
        self._model = model
        # What a PTZ head at rest may still have moved.
        self._moved = (tolerance.angle_deg, tolerance.angle_deg)

    def pose(self, reading: PtzReading) -> tuple[Pose, Float64Array]:
        return self._model.pose(reading.pan_deg, reading.tilt_deg, self._moved)


def gaze_of_ptz(site: Site, mount: MountConfig, ptz: PtzConfig | None, source: SourceConfig | None) -> Gaze:
    """Asks the PTZ head nothing yet. Without `ptz`, directions come with the pictures. Raises what `MountConfig.model`
    raises."""
    model = mount.model(site.open_dem(), site.frame)
    lens = None if mount.lens is None else mount.lens.lens()
    if ptz is None:
        return Gaze(model=MountPoses(model, Tolerance()), lens=lens)
    tolerance = tolerance_of(ptz)
    direction = PtzDirection(lambda: open_ptz(ptz, source))
    return Gaze(
        direction=direction,
        model=MountPoses(model, tolerance),
        tolerance=tolerance,
        lens=lens,
        patrol=None if ptz.patrol is None else PtzPatrol(direction, ptz.patrol, tolerance),
    )


def calibration_of(camera: CameraConfig, name: str) -> Camera:
    """Of a lens that zooms, at its widest. Raises ConfigError where the site file states none."""
    if camera.mount is not None and camera.mount.lens is not None:
        lens = camera.mount.lens.lens()
        return lens.camera(lens.table[0][0])
    if camera.calibration is None:
        raise ConfigError(f"camera {name} has neither calibration nor mount.lens in the site file")
    return camera.calibration.camera()


def gaze_of(site: Site, camera: CameraConfig) -> Gaze:
    """Of a camera that stands still, the pose that the site file states; of one on a PTZ head, what makes poses of its
    readings."""
    if camera.mount is not None:
        return gaze_of_ptz(site, camera.mount, camera.ptz, camera.source)
    if camera.pose is None:
        return Gaze()
    pose = camera.pose.pose(site.open_dem(), site.frame)
    assumed = site.assumed_pose_error
    covariance = camera.pose.covariance(pose, assumed.position, assumed.angle_deg)
    return Gaze(pose, assumed.covariance() if covariance is None else covariance)
