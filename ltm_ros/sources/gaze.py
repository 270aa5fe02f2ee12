"""How a camera's source knows where it looks and what its lens is, from the camera's sections in the site file."""

from __future__ import annotations

from ltm_core.camera import Camera
from ltm_core.errors import ConfigError
from ltm_core.site import Site
from ltm_core.site_sections import CameraConfig
from ltm_ros.sources.camera_source import Gaze
from ltm_ros.sources.ptz.gaze import gaze_of_head


def calibration_of(camera: CameraConfig, name: str) -> Camera:
    """Of a lens that zooms, at its widest. Raises ConfigError where the site file states none."""
    if camera.mount is not None and camera.mount.lens is not None:
        lens = camera.mount.lens.lens()
        return lens.camera(lens.table[0][0])
    if camera.calibration is None:
        raise ConfigError(f"camera {name} has neither calibration nor mount.lens in the site file")
    return camera.calibration.camera()


def gaze_of(site: Site, camera: CameraConfig) -> Gaze:
    """Of a camera that stands still, the pose that the site file states; of one on a head, what makes poses of its
    readings."""
    if camera.mount is not None:
        return gaze_of_head(site, camera.mount, camera.ptz, camera.source)
    if camera.pose is None:
        return Gaze()
    pose = camera.pose.pose(site.open_dem(), site.frame)
    assumed = site.assumed_pose_error
    covariance = camera.pose.covariance(pose, assumed.position, assumed.angle_deg)
    return Gaze(pose, assumed.covariance() if covariance is None else covariance)
