"""Convert CameraInfo, Imu and NavSatFix to core types, and back."""

import math
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, NavSatFix, NavSatStatus

from ltm_core.base.errors import CameraError, PoseError
from ltm_core.base.types import Float64Array
from ltm_core.cameras.sensor_pose import Attitude, Fix
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.pose import UNKNOWN_VARIANCES
from ltm_msgs_py.stamp import make_header, stamp_of


def msg_to_attitude(msg: Any) -> Attitude:
    """Return an attitude in a world of x east, y north, z up (REP-103, REP-145). A covariance of zeros is unknown.

    Raises PoseError without an orientation (covariance[0] = -1), and for an invalid quaternion or covariance."""
    if msg.orientation_covariance[0] == -1.0:
        raise PoseError(
            "the Imu message states that it has no orientation (orientation_covariance[0] = -1): publish the "
            "phone's rotation vector, or fuse its sensors first (imu_filter_madgwick with a magnetometer)"
        )
    covariance = _covariance(msg.orientation_covariance, "the Imu message's orientation_covariance", "zeros")
    q = msg.orientation
    rotation = Pose.from_quaternion((0.0, 0.0, 0.0), (q.x, q.y, q.z, q.w)).rotation
    return Attitude(stamp_of(msg), rotation, covariance if covariance.any() else None)


def _covariance(values: Any, what: str, unknown: str) -> Float64Array:
    covariance = np.array(values, np.float64).reshape(3, 3)
    if not np.isfinite(covariance).all() or (covariance.diagonal() < 0).any():
        what = f"{what} must be finite without negative variances, got {covariance.tolist()}"
        raise PoseError(f"{what}; send {unknown} if it is unknown")
    return covariance


_NO_FIX = -1
_COVARIANCE_UNKNOWN = 0


def msg_to_fix(msg: Any) -> Fix:
    """Return a GPS fix. Raises PoseError: no fix, invalid position or covariance."""
    if msg.status.status == _NO_FIX:
        raise PoseError("the receiver reports no GPS fix (status -1): wait for one under open sky")
    lon, lat = float(msg.longitude), float(msg.latitude)
    if not (math.isfinite(lon) and math.isfinite(lat) and abs(lat) <= 90 and abs(lon) <= 180):
        raise PoseError(f"invalid GPS fix at lat {lat}, lon {lon}")
    if (lat, lon) == (0.0, 0.0):
        raise PoseError("receivers send a GPS fix at (0, 0) if they have none: wait for one under open sky")
    covariance = None
    if msg.position_covariance_type != _COVARIANCE_UNKNOWN:
        what = "the GPS fix's position_covariance"
        covariance = _covariance(msg.position_covariance, what, "position_covariance_type 0")
        if not covariance.diagonal().any():
            covariance = None
    return Fix(stamp_of(msg), lon, lat, float(msg.altitude), covariance)


def place_to_fix(lon: float, lat: float, covariance: Float64Array, stamp_ns: int, frame_id: str) -> NavSatFix:
    """Return a place with its (2, 2) covariance of east and north. The altitude, which is ellipsoidal, is NaN.

    Raises MessageError on a bad stamp."""
    matrix = np.diag([0.0, 0.0, UNKNOWN_VARIANCES[2]])
    matrix[:2, :2] = covariance
    msg = NavSatFix(header=make_header(stamp_ns, frame_id), altitude=math.nan, longitude=lon, latitude=lat)
    msg.status.status = NavSatStatus.STATUS_FIX
    msg.position_covariance = matrix.ravel()
    diagonal = not covariance[0, 1] and not covariance[1, 0]
    kind = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN if diagonal else NavSatFix.COVARIANCE_TYPE_KNOWN
    msg.position_covariance_type = kind
    return msg


def camera_to_msg(camera: Camera, stamp_ns: int, frame_id: str) -> CameraInfo:
    """Return a camera as CameraInfo with the plumb_bob model, for the raw image. Raises MessageError on a bad stamp."""
    msg = CameraInfo(header=make_header(stamp_ns, frame_id), height=camera.height, width=camera.width)
    msg.distortion_model = "plumb_bob"
    msg.d = [float(v) for v in camera.distortion]
    msg.k = camera.matrix.ravel()
    msg.r = np.eye(3).ravel()
    msg.p = np.hstack([camera.matrix, np.zeros((3, 1))]).ravel()
    return msg


def msg_to_camera(msg: Any) -> Camera:
    """Return the camera that a CameraInfo describes.

    Taken: plumb_bob with D of 0, 4 (k1 k2 p1 p2) or 5 (and k3) numbers, at full resolution. R and P are for rectified
    images and left aside. Raises CameraError on an uncalibrated camera (K[0] = 0), another distortion model, a skewed
    or non-finite K, binning, or a region of interest."""
    who = f"CameraInfo of frame {msg.header.frame_id!r}"
    k = np.asarray(msg.k, np.float64)
    d = [float(v) for v in msg.d]
    if k.shape != (9,) or not np.isfinite(k).all():
        raise CameraError(f"{who}: K must be nine finite numbers, got {k.tolist()}")
    if k[0] == 0:
        raise CameraError(f"{who}: K[0] is 0, which marks an uncalibrated camera; calibrate it first")
    if k[1] != 0 or k[3] != 0 or k[6] != 0 or k[7] != 0 or k[8] != 1:
        raise CameraError(f"{who}: K must be [fx 0 cx; 0 fy cy; 0 0 1] without skew, got {k.tolist()}")
    if msg.distortion_model != "plumb_bob" and not (msg.distortion_model == "" and not any(d)):
        what = f"{who}: distortion model {msg.distortion_model!r} is not supported, only 'plumb_bob'"
        raise CameraError(f"{what}; undistort the images or calibrate with plumb_bob")
    if len(d) not in (0, 4, 5):
        raise CameraError(f"{who}: plumb_bob has D = (k1, k2, p1, p2[, k3]), 0, 4 or 5 numbers; got {len(d)}: {d}")
    if msg.binning_x > 1 or msg.binning_y > 1:
        raise CameraError(f"{who}: binning {msg.binning_x} x {msg.binning_y}; publish K for the image as sent")
    roi = (msg.roi.x_offset, msg.roi.y_offset, msg.roi.width, msg.roi.height)
    if roi not in ((0, 0, 0, 0), (0, 0, msg.width, msg.height)):
        raise CameraError(f"{who}: region of interest x, y, width, height = {roi}; publish K for the image as sent")
    k1, k2, p1, p2, k3 = [*d, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    fx, fy, cx, cy = (float(k[i]) for i in (0, 4, 2, 5))
    try:
        return Camera(int(msg.width), int(msg.height), fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    except CameraError as error:
        raise CameraError(f"{who}: {error}") from error
