"""Convert poses, transforms, corrections of mounts and places to geometry_msgs, and back.

- Poses are of the camera's optical frame in `header.frame_id`.
- A correction of a mount is a PoseWithCovarianceStamped that moves nothing, with a covariance of zeros if it is as
  stated; the tilt zero of a PTZ head is in the status `pose/info` of the same stamp.
- Regions of images are in the optical frame: x and y are pixels u and v; z is ignored."""

from typing import Any

import numpy as np
from geometry_msgs.msg import Point32, Polygon, PolygonStamped, PoseWithCovarianceStamped, TransformStamped
from geometry_msgs.msg import Pose as PoseMsg
from numpy.typing import ArrayLike

from ltm_core.base.errors import MessageError, PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose, matrix_of_vector, vector_of_matrix
from ltm_core.locating.region import MOST_VERTICES
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_msgs_py.stamp import make_header
from ltm_msgs_py.status import msg_to_values

POSE_TYPES = (
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/TransformStamped",
)
"""Message types of poses that are read."""
UNKNOWN_VARIANCES = (99_999.0,) * 3 + (np.pi**2,) * 3
"""Variances from here on mean unknown, in m^2 and rad^2: drivers write 99999, 1e6, 1e9 or the largest double, and a
direction with a larger standard deviation than half a turn is unknown."""


def pose_to_msg(
    pose: Pose, stamp_ns: int, frame_id: str = "map", covariance: ArrayLike | None = None
) -> PoseWithCovarianceStamped:
    """Return a pose with its covariance, (6, 6) over x, y, z (m) and rotations about x, y, z (rad); zeros: unknown.

    Raises PoseError on a covariance of another shape or that is not finite."""
    msg = PoseWithCovarianceStamped(header=make_header(stamp_ns, frame_id))
    msg.pose.pose = _pose_msg(pose)
    if covariance is not None:
        values = np.asarray(covariance, np.float64)
        if values.shape != (6, 6) or not np.isfinite(values).all():
            raise PoseError(f"pose covariance must be a finite 6 x 6 matrix, got {values.tolist()}")
        msg.pose.covariance = values.ravel()
    return msg


def as_stamped_pose(msg: Any, any_frame: bool = False) -> PoseWithCovarianceStamped:
    """Return a message of `POSE_TYPES` as a pose with covariance; zeros if it has none.

    Raises PoseError for the odometry or transform of another frame than a camera's optical one, unless `any_frame`."""
    if isinstance(msg, PoseWithCovarianceStamped):
        return msg
    child = getattr(msg, "child_frame_id", "optical")
    if not child.endswith("optical") and not any_frame:
        what = f"{type(msg).__name__} gives the pose of the frame {child!r}, not of the optical frame"
        raise PoseError(f"{what}; publish the transform between them on /tf_static")
    made = PoseWithCovarianceStamped(header=msg.header)
    if hasattr(getattr(msg, "pose", None), "covariance"):
        made.pose = msg.pose
    else:
        made.pose.pose = _pose_msg(msg_to_transform(msg)) if isinstance(msg, TransformStamped) else msg.pose
    return made


def msg_to_transform(msg: TransformStamped) -> Pose:
    """Return the pose of the child frame in its parent. Raises PoseError as `msg_to_pose`."""
    p, q = msg.transform.translation, msg.transform.rotation
    return Pose.from_quaternion((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def mount_transform(camera: str) -> TransformStamped:
    """Return the static transform of a camera, from its link (x forward, z up) to its optical frame (x right, y down),
    by REP-103."""
    made = TransformStamped(header=make_header(0, f"{camera}_link"), child_frame_id=f"{camera}_optical")
    turn = made.transform.rotation
    turn.x, turn.y, turn.z, turn.w = -0.5, 0.5, -0.5, 0.5
    return made


def link_transform(camera: str, posed: Any) -> TransformStamped:
    """Return the transform from the map to a camera's link, of its PoseWithCovarianceStamped.

    The quaternion is multiplied here, because recorders need no other rotation, and SciPy's take 20 MB."""
    made = TransformStamped(header=posed.header, child_frame_id=f"{camera}_link")
    p, q = posed.pose.pose.position, posed.pose.pose.orientation
    move, turn = made.transform.translation, made.transform.rotation
    move.x, move.y, move.z = p.x, p.y, p.z
    turn.x = (q.w + q.x + q.y + q.z) / 2
    turn.y = (-q.w - q.x + q.y + q.z) / 2
    turn.z = (q.w - q.x - q.y + q.z) / 2
    turn.w = (q.w - q.x + q.y - q.z) / 2
    return made


def msg_to_pose(msg: Any, frame_id: str | None = None) -> Pose:
    """Return the pose of a PoseWithCovarianceStamped or PoseStamped.

    `frame_id`: the frame that the pose must be given in, when it matters. Raises PoseError on another frame, NaN or
    infinite numbers, or a quaternion whose norm is not 1 within 1e-3 (an unset one is zero)."""
    stamped_in = msg.header.frame_id
    if frame_id is not None and stamped_in != frame_id:
        raise PoseError(f"pose is in frame {stamped_in!r}, expected {frame_id!r}")
    pose = msg.pose.pose if hasattr(msg.pose, "pose") else msg.pose
    p, q = pose.position, pose.orientation
    return Pose.from_quaternion((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def msg_to_covariance(msg: Any, assumed: Float64Array | None = None) -> Float64Array | None:
    """Return the covariance of a PoseWithCovarianceStamped, (6, 6) over x, y, z (m) and rotations about x, y, z (rad).

    Unknown are: all of it where all is zero or the first number is -1 (as in sensor_msgs/Imu), and each axis whose
    variance is infinite or `UNKNOWN_VARIANCES` at least. `assumed`: (6, 6), stands for what is unknown; without it the
    answer is None where anything is. Raises PoseError for one that is none: NaN, not symmetric, negative variances."""
    given = np.array(msg.pose.covariance, np.float64).reshape(6, 6)
    if given[0, 0] == -1.0 or not given.any():
        return assumed
    variances = given.diagonal()
    if np.isnan(given).any() or (variances < 0).any():
        raise PoseError(f"pose covariance has invalid variances {variances.tolist()}; send zeros if unknown")
    known = variances < UNKNOWN_VARIANCES
    matrix = given[np.ix_(known, known)]
    if not np.isfinite(matrix).all():
        raise PoseError(f"pose covariance must be finite if it is known, got {given.tolist()}")
    _check_correlations(matrix)
    if known.all():
        return (given + given.T) / 2
    if assumed is None:
        return None
    filled = np.zeros((6, 6))
    filled[np.ix_(known, known)] = (matrix + matrix.T) / 2
    filled[np.ix_(~known, ~known)] = assumed[np.ix_(~known, ~known)]
    return filled


def _check_correlations(matrix: Float64Array) -> None:
    """Check correlations. Raises PoseError. Metres and radians differ in size, so normalised values are compared."""
    sigmas = np.sqrt(matrix.diagonal())
    scale = np.outer(sigmas, sigmas)
    sure = scale == 0  # an axis without any error has none in common with others
    with np.errstate(over="ignore"):
        correlations = matrix / np.where(sure, 1.0, scale)
    if (
        (matrix[sure] != 0).any()
        or (np.abs(correlations) > 1 + 1e-6).any()
        or (np.abs(correlations - correlations.T) > 1e-6).any()
        or (len(matrix) and np.linalg.eigvalsh(correlations).min() < -1e-6)
    ):
        what = f"pose covariance must be symmetric and without negative eigenvalues, got {matrix.tolist()}"
        raise PoseError(f"{what}; send zeros if it is unknown")


def _pose_msg(pose: Pose) -> PoseMsg:
    msg = PoseMsg()
    msg.position.x, msg.position.y, msg.position.z = (float(v) for v in pose.position)
    o = msg.orientation
    o.x, o.y, o.z, o.w = pose.quaternion
    return msg


def correction_to_msg(correction: PoseCorrection, stamp_ns: int) -> Any:
    """Return the rotation of a correction and its covariance; the tilt zero is in `correction_values`."""
    turn = Pose(np.zeros(3), matrix_of_vector(correction.rotation))
    covariance = np.zeros((6, 6))
    if correction.angles is not None:
        covariance[3:, 3:] = correction.angles
    return pose_to_msg(turn, stamp_ns, "map", covariance)


def correction_values(correction: PoseCorrection) -> dict[str, object]:
    """Return the part of a correction that has no standard message: a PTZ head's tilt zero (rad), and its covariance
    with the rotation about x, y and z and its variance (rad²)."""
    return {"tilt_zero": correction.tilt_zero, "tilt_covariance": correction.tilt_covariance}


def msgs_to_correction(correction: Any, info: Any) -> PoseCorrection:
    """Return the correction of a mount from `pose/correction` and `pose/info` of a stamp. Raises MessageError,
    PoseError."""
    values, covariance = msg_to_values(info), msg_to_covariance(correction)
    rotation = vector_of_matrix(msg_to_pose(correction, "map").rotation)
    try:
        numbers = np.array([values["tilt_zero"], *values["tilt_covariance"].split()], np.float64)
    except (KeyError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (5,) or not np.isfinite(numbers).all():
        raise MessageError("pose/info: expected tilt_zero and the four numbers of tilt_covariance, all finite")
    if covariance is None:
        return PoseCorrection(rotation, None, float(numbers[0]))
    return PoseCorrection(rotation, covariance[3:, 3:], float(numbers[0]), numbers[1:])


def msg_to_outline(msg: Any, frame_id: str) -> Float64Array:
    """Return pixels (N, 2) of a PolygonStamped, or (1, 2) of a PointStamped.

    Raises MessageError: another frame, no point, too many, numbers that are not finite."""
    if msg.header.frame_id != frame_id:
        raise MessageError(f"region is in frame {msg.header.frame_id!r}, expected {frame_id!r}, in pixels")
    points = [msg.point] if hasattr(msg, "point") else msg.polygon.points
    if not 1 <= len(points) <= MOST_VERTICES:
        raise MessageError(f"a region needs 1 to {MOST_VERTICES} points, got {len(points)}")
    outline = np.array([(point.x, point.y) for point in points], np.float64)
    if not np.isfinite(outline).all():
        raise MessageError("a region's points must be finite pixels")
    return outline


def place_to_msg(
    place: Float64Array, covariance: Float64Array, height_variance: float, stamp_ns: int
) -> PoseWithCovarianceStamped:
    """Return a place (3,) of the map with its (2, 2) covariance; its orientation is marked as unknown."""
    msg = PoseWithCovarianceStamped(header=make_header(stamp_ns, "map"))
    position = msg.pose.pose.position
    position.x, position.y, position.z = (float(v) for v in place)
    msg.pose.pose.orientation.w = 1.0
    matrix = np.zeros((6, 6))
    matrix[:2, :2] = covariance
    matrix[2, 2] = height_variance
    matrix[3:, 3:] = np.diag(UNKNOWN_VARIANCES[3:])
    msg.pose.covariance = matrix.ravel()
    return msg


def outline_to_msg(outline: Float64Array, stamp_ns: int) -> PolygonStamped:
    """Return an outline (N, 2) of the map."""
    points = [Point32(x=float(x), y=float(y)) for x, y in outline]
    return PolygonStamped(header=make_header(stamp_ns, "map"), polygon=Polygon(points=points))
