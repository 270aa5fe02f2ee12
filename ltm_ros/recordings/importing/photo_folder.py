"""Write imported photos as files with a photo list of their known values, for `ltm pose photo`."""

from __future__ import annotations

import csv
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.utc_time import moment_of_stamp
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, pose_sigmas
from ltm_ros.recordings.importing.georeference import PlacedPhoto

POSES = "poses.csv"
_ANGLES = ("azimuth", "pitch", "roll")
_UNKNOWN = (UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, UNKNOWN_AZIMUTH_SIGMA_DEG)
"""Standard deviations of unknown angles."""
_SUFFIXES = {"jpeg": ".jpg", "png": ".png"}


class PhotoFolder:
    """A new or empty folder for the upright photos and `poses.csv`. Raises RecordingError otherwise."""

    def __init__(self, path: Path, frame: SiteFrame) -> None:
        self._path, self._frame = path, frame
        self._rows: list[dict[str, str]] = []
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise RecordingError(f"{path} exists already and is not an empty folder: remove it, or give another folder")

    def __enter__(self) -> Self:
        self._path.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        columns = list(dict.fromkeys(key for row in self._rows for key in row))
        with (self._path / POSES).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
            writer.writeheader()
            writer.writerows(self._rows)

    def add(self, name: str, camera: str, item: PlacedPhoto, stamp_ns: int) -> None:
        """Add a photo, with its pose in the bag, and its stated standard deviations."""
        photo, pose, lens = item.photo, item.pose, item.camera
        file = Path(name).stem + _SUFFIXES[photo.image_format]
        (self._path / file).write_bytes(photo.data)
        taken = moment_of_stamp(stamp_ns)
        x, y, z = pose.position
        row = {"name": file, "camera": camera, "stamp": taken.isoformat(), "crs": self._frame.crs}
        row |= {"x": f"{x + self._frame.x_origin:.3f}", "y": f"{y + self._frame.y_origin:.3f}", "z": f"{z:.3f}"}
        sigmas = np.zeros(6) if item.covariance is None else pose_sigmas(pose, item.covariance)
        for key, value, sigma, unknown in zip(_ANGLES, pose.angles_deg, sigmas[3:], _UNKNOWN, strict=True):
            if sigma < 0.99 * unknown:  # unknown values stay empty
                row |= {f"{key}_deg": f"{value:.4f}"} | ({f"{key}_sigma_deg": f"{sigma:.4g}"} if sigma > 0 else {})
        if item.covariance is not None:
            row |= {"position_sigma": f"{sigmas[0]:.4g}", "height_sigma": f"{sigmas[2]:.4g}"}
        row |= {"width": str(lens.width), "height": str(lens.height)}
        row |= {key: f"{getattr(lens, key):.4f}" for key in ("fx", "fy", "cx", "cy")}
        names = ("k1", "k2", "p1", "p2", "k3")
        row |= {key: f"{value!r}" for key, value in zip(names, lens.distortion, strict=True) if value}
        self._rows.append(row)
