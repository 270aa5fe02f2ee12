"""Read captures by ARKit: Stray Scanner's folders, and Record3D's .r3d files and exported folders.

Their poses are relative to the start of the app: neither place nor date is recorded. A row of the pose file named after
the capture gives the place of its first frame. Stray Scanner's world is upright (y up) with any heading, and its
quaternions use OpenCV's camera axes. Record3D's world is that of its first frame, so that even gravity is unknown, and
its quaternions use OpenGL's axes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.cameras.camera_config import PartialCalibration
from ltm_core.cameras.sensor_pose import ENU_FROM_EUS, OPENGL_FROM_OPTICAL, optical_angles_deg
from ltm_core.storage.text_io import LARGEST_FILE
from ltm_msgs_py.image import decode_rgb
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.capture_files import LARGEST_JSON, CaptureFiles, table
from ltm_ros.recordings.importing.photo import ImportedImage, Photo
from ltm_ros.recordings.importing.sensor_track import Relative, Sensed
from ltm_ros.recordings.importing.video import frame_photo, later, read_video

_ODOMETRY = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")
_LENS = ("fx", "fy", "cx", "cy")
_TILT_SIGMA_DEG = 0.5
"""Standard deviation of ARKit's gravity in degrees."""
_QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Optical frame of an image rotated clockwise by 90 degrees, in that of the original image."""


@dataclass(frozen=True, eq=False)
class _CaptureFrame:
    """`rotation` (3, 3): optical to the capture's world, x and y level and z up if known. `position` (3,) metres there.
    `lens`: fx, fy, cx, cy of the stored image. `number`: of the frame; `seconds`: after the first.
    """

    number: int
    seconds: float
    rotation: Float64Array
    position: Float64Array
    lens: tuple[float, float, float, float]


def is_stray_scanner(files: CaptureFiles) -> bool:
    return all(files.find(name) is not None for name in ("odometry.csv", "rgb.mp4"))


def stray_scanner_pictures(files: CaptureFiles, assumed: Assumptions) -> list[ImportedImage]:
    """Return a frame every `assumed.every` seconds of a Stray Scanner folder. Raises RecordingError."""
    if not files.path.is_dir():
        raise RecordingError(
            f"{files.path}: unpack Stray Scanner's zip and give its folder, because its video cannot be read from a zip"
        )
    columns = table(files, files.find("odometry.csv") or "", (*_ODOMETRY, *_LENS))
    video = read_video(files.path / (files.find("rgb.mp4") or ""), assumed.every)
    matrix = files.find("camera_matrix.csv")
    whole = _camera_matrix(files, matrix) if matrix is not None else None
    frames = _every(_odometry(columns, whole, str(files.path)), assumed.every)
    turns = round(_roll(frames[0]) / 90) % 4

    def picture(frame: _CaptureFrame) -> ImportedImage:
        name = f"{frame.number:06d}.jpg"

        def read() -> Photo:
            pixels = video.stored(frame.seconds)
            stamp = later(video.begins, frame.seconds) if video.begins is not None else None
            told = _sensed("Stray Scanner", frames[0], frame, turns, pixels, level=True)
            return frame_photo(_turned(pixels, turns), files.path / name, replace(told, stamp=stamp))

        return ImportedImage(name, files.path / name, read, capture=files.path.name)

    return [picture(frame) for frame in frames]


def is_record3d(files: CaptureFiles) -> bool:
    return _metadata_name(files) is not None and bool(_record3d_images(files))


def record3d_pictures(files: CaptureFiles, assumed: Assumptions) -> list[ImportedImage]:
    """Return a frame every `assumed.every` seconds of an .r3d file or an exported folder. Raises RecordingError."""
    metadata = _metadata_name(files) or ""
    place = f"{files.path}: {metadata!r}"
    try:
        facts = json.loads(files.text(metadata, LARGEST_JSON))
        fps, poses = float(facts.get("fps") or 30.0), np.asarray(facts["poses"], np.float64)
        one = [float(v) for v in facts["K"]] if "K" in facts else []
        each = facts.get("perFrameIntrinsicCoeffs")
        lenses = np.asarray(each, np.float64) if each else np.tile(_lens_of(one), (len(poses), 1))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, IndexError) as error:
        raise RecordingError(f"{place}: is not metadata of Record3D ({type(error).__name__}: {error})") from error
    if (
        poses.ndim != 2
        or poses.shape[1] != 7
        or not len(poses)
        or lenses.shape[:1] != poses.shape[:1]
        or lenses.shape[1:] != (4,)
    ):
        raise RecordingError(
            f"{place}: poses of shape {poses.shape} and intrinsics of {lenses.shape}: expected N x 7 and N x 4; "
            "record with LiDAR"
        )
    if not 0 < fps < 1000:
        raise RecordingError(f"{place}: {fps} frames per second")
    images = _record3d_images(files)
    rotations = _rotations(poses[:, :4], place) @ OPENGL_FROM_OPTICAL
    frames = [
        _CaptureFrame(k, k / fps, rotations[k], poses[k, 4:], tuple(lenses[k]))
        for k in range(len(poses))
        if k in images and np.isfinite(poses[k]).all() and np.isfinite(lenses[k]).all()
    ]
    if not frames:
        raise RecordingError(f"{place}: none of its {len(poses)} poses belongs to one of its {len(images)} images")
    frames = _every(frames, assumed.every)

    def picture(frame: _CaptureFrame) -> ImportedImage:
        path = files.path / f"{frame.number}.jpg"

        def read() -> Photo:
            pixels = decode_rgb(files.read(images[frame.number], LARGEST_FILE), str(path))
            return frame_photo(pixels, path, _sensed("Record3D", frames[0], frame, 0, pixels, level=False))

        return ImportedImage(path.name, path, read, capture=files.path.name)

    return [picture(frame) for frame in frames]


def _metadata_name(files: CaptureFiles) -> str | None:
    return files.find("metadata") or files.find("metadata.json")


def _record3d_images(files: CaptureFiles) -> dict[int, str]:
    names = files.matching("rgbd", (".jpg",)) or files.matching("rgb", (".jpg",))
    stems = {name: Path(name).stem for name in names}
    return {int(stem): name for name, stem in stems.items() if stem.isascii() and stem.isdigit() and len(stem) < 9}


def _odometry(columns: dict[str, list[str]], whole: tuple[float, ...] | None, place: str) -> list[_CaptureFrame]:
    lacking = set(_ODOMETRY) - columns.keys()
    if lacking:
        raise RecordingError(
            f"{place}: odometry.csv has no column {', '.join(sorted(lacking))}: is it Stray Scanner's?"
        )
    try:
        numbers = np.array([[float(v) for v in columns[name]] for name in _ODOMETRY]).T
    except ValueError as error:
        raise RecordingError(f"{place}: odometry.csv contains an invalid number ({error})") from error
    if not len(numbers) or not np.isfinite(numbers).all():
        raise RecordingError(f"{place}: odometry.csv has {len(numbers)} rows, of which all must be finite numbers")
    lenses = _row_lenses(columns, len(numbers))
    if lenses is None and whole is None:
        raise RecordingError(
            f"{place}: no camera_matrix.csv, and no fx, fy, cx, cy in odometry.csv: export the scan again"
        )
    rotations = ENU_FROM_EUS @ _rotations(numbers[:, 5:], place)
    positions = numbers[:, 2:5] @ ENU_FROM_EUS.T
    return [
        _CaptureFrame(
            int(row[1]),
            float(row[0] - numbers[0, 0]),
            rotations[k],
            positions[k],
            lenses[k] if lenses else whole,  # type: ignore[arg-type]
        )
        for k, row in enumerate(numbers)
    ]


def _row_lenses(columns: dict[str, list[str]], count: int) -> list[tuple[float, float, float, float]] | None:
    """Return the lens of each row, in newer recordings."""
    try:
        found = np.array([[float(v) for v in columns[name]] for name in _LENS]).T
    except (KeyError, ValueError):
        return None
    return [tuple(map(float, row)) for row in found] if np.isfinite(found).all() else None  # type: ignore[misc]


def _camera_matrix(files: CaptureFiles, name: str) -> tuple[float, float, float, float]:
    try:
        k = np.array(
            [[float(v) for v in line.split(",")] for line in files.text(name, LARGEST_JSON).split("\n") if line.strip()]
        )
        return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])
    except (ValueError, IndexError) as error:
        raise RecordingError(f"{files.path}: {name!r} is not a 3 x 3 matrix of numbers ({error})") from error


def _lens_of(k: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the lens; K is stored column by column."""
    return k[0], k[4], k[6], k[7]


def _rotations(quaternions: Float64Array, place: str) -> Float64Array:
    norms = np.linalg.norm(quaternions, axis=1)
    if not (np.abs(norms - 1) < 0.01).all():
        raise RecordingError(f"{place}: quaternions must have a norm of 1, got {norms.min():.3g} to {norms.max():.3g}")
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def _every(frames: list[_CaptureFrame], seconds: float) -> list[_CaptureFrame]:
    kept: list[_CaptureFrame] = []
    for frame in frames:
        if not kept or frame.seconds >= kept[-1].seconds + seconds - 1e-6:
            kept.append(frame)
    return kept


def _roll(frame: _CaptureFrame) -> float:
    return optical_angles_deg(frame.rotation)[2]


def _turned(pixels: UInt8Array, turns: int) -> UInt8Array:
    """Rotate clockwise by quarter turns."""
    return np.ascontiguousarray(np.rot90(pixels, -turns))


def _sensed(
    source: str, first: _CaptureFrame, frame: _CaptureFrame, turns: int, pixels: UInt8Array, level: bool
) -> Sensed:
    """Return the sensed pose of the image after the given quarter turns."""
    turn = np.linalg.matrix_power(_QUARTER, turns)
    origin, here = first.rotation @ turn, frame.rotation @ turn
    fx, fy, cx, cy = frame.lens
    height = pixels.shape[0]
    width = pixels.shape[1]
    for _ in range(turns):
        fx, fy, cx, cy = fy, fx, height - 1 - cy, cx
        width, height = height, width
    if not (fx > 0 and fy > 0 and all(map(math.isfinite, (fx, fy, cx, cy)))):
        raise RecordingError(
            f"frame {frame.number} of {source} has the focal lengths {fx:g}, {fy:g}: they must be positive"
        )
    _, pitch, roll = optical_angles_deg(origin)
    return Sensed(
        source=source,
        pitch_deg=pitch if level else None,
        roll_deg=roll if level else None,
        tilt_sigma_deg=_TILT_SIGMA_DEG if level else None,
        calibration=PartialCalibration(fx=fx, fy=fy, cx=cx, cy=cy),
        seconds=frame.seconds,
        relative=Relative(origin.T @ here, origin.T @ (frame.position - first.position)),
        missing="give the position of its first frame in a row named after the capture",
    )
