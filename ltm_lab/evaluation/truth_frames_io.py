"""Reads simulated frames with their true depth from a folder of `ltm-lab simulate`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem
from ltm_core.storage.photo_io import check_picture
from ltm_core.storage.text_io import load_arrays, read_text

LARGEST_INDEX = 64 << 20
"""Bytes of `frames.json`: a frame takes one thousand."""
_LARGEST_TRUTH = 1 << 30
"""Bytes of an array of a frame's truth."""


@dataclass(frozen=True, eq=False)
class TruthFrame:
    """A photo (H, W, 3) with what is true of every `step`-th of its pixels, (h, w) from the first: `surface` and
    `ground`, depth along the optical axis of what is seen and of bare ground, +inf sky; `labels`, class ids; `changed`,
    whether the ground or what grows there is another than at the time of the DEM.
    """

    camera_name: str
    stamp_ns: int
    camera: Camera
    pose: Pose
    photo: UInt8Array
    surface: Float32Array
    ground: Float32Array
    labels: UInt8Array
    changed: BoolArray
    date: str = ""

    @property
    def step(self) -> int:
        across: int = self.surface.shape[1]
        return round(self.camera.width / across)


class _Lenient(BaseModel):
    """Part of `frames.json`, which holds more than is read here."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class _CameraEntry(_Lenient):
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]

    def camera(self) -> Camera:
        return Camera(**dict(self))


class _FrameEntry(_Lenient):
    camera_name: str
    stamp_ns: int
    image: str = Field(pattern=r"^[\w./-]+$")
    truth: str = Field(pattern=r"^[\w./-]+$")
    camera: _CameraEntry
    truth_camera: _CameraEntry
    position: tuple[float, float, float]
    azimuth_deg: float
    pitch_deg: float
    roll_deg: float
    date: str = Field("", pattern=r"^[\w.-]*$")

    def pose(self) -> Pose:
        return Pose.from_angles(self.position, self.azimuth_deg, self.pitch_deg, self.roll_deg)


class _Date(_Lenient):
    name: str = Field(pattern=r"^[\w.-]*$")


class _Index(_Lenient):
    scenario: str
    crs: str
    origin: tuple[float, float]
    curvature: bool
    dates: list[_Date] = Field(default_factory=list)
    frames: list[_FrameEntry]


def open_dem(folder: Path) -> Dem:
    """The outdated DEM of a folder of `ltm-lab simulate`, in the map frame. Raises RecordingError, RasterError."""
    return Dem.open(folder / "dem.tif").in_frame(site_frame(folder))


def site_frame(folder: Path) -> SiteFrame:
    """The map frame of a folder. Raises RecordingError."""
    return _frame(_index(folder))


def scenario_name(folder: Path) -> str:
    """Of what a folder shows. Raises RecordingError."""
    return _index(folder).scenario


def is_curved(folder: Path) -> bool:
    """Whether the earth's curvature is in the scene of a folder. Raises RecordingError."""
    return _index(folder).curvature


def read_truth_frames(folder: Path, date: str = "") -> Iterator[TruthFrame]:
    """The frames of a folder, of one date where it has several (empty: all). Raises RecordingError."""
    index = _index(folder)
    frame, bend = _frame(index), ray_bend(index.curvature, 0.13)
    first = next((d.name for d in index.dates), "")
    for entry in index.frames:
        when = entry.date
        if date and when != date:
            continue
        check_picture(folder / entry.image)
        photo = cv2.imread(str(folder / entry.image), cv2.IMREAD_COLOR)
        if photo is None:
            raise RecordingError(f"{folder / entry.image}: the frame's picture is missing or broken")
        camera, sampled, pose = entry.camera.camera(), entry.truth_camera.camera(), entry.pose()
        ranges_seen, ranges_ground, ids = load_arrays(
            folder / entry.truth, ("range_surface", "range_ground", "labels"), _LARGEST_TRUTH, RecordingError
        )
        try:
            surface = RangeImage(ranges_seen.astype(np.float32), sampled, pose, bend)
            ground = RangeImage(ranges_ground.astype(np.float32), sampled, pose, bend).depth()
            labels = ids.astype(np.uint8)
        except ValueError as error:
            raise RecordingError(f"{folder / entry.truth}: no truth of the frame ({error})") from error
        change = folder / "truth" / f"change_{first}_{when}.tif"
        changed = _changed(surface, change, frame) if change.is_file() else np.zeros(labels.shape, np.bool_)
        yield TruthFrame(
            entry.camera_name,
            entry.stamp_ns,
            camera,
            pose,
            np.ascontiguousarray(photo[..., ::-1]),
            surface.depth(),
            ground,
            labels,
            changed,
            when,
        )


def dates(folder: Path) -> list[str]:
    """Names of a folder's dates; empty where it has one only."""
    return [date.name for date in _index(folder).dates]


def _changed(surface: RangeImage, change: Path, frame: SiteFrame) -> BoolArray:
    import rasterio

    points = surface.points()
    with rasterio.open(change) as source:
        bits = source.read(1)
        to_cell = ~source.transform
    x, y = points[..., 0].astype(np.float64) + frame.x_origin, points[..., 1].astype(np.float64) + frame.y_origin
    seen = np.isfinite(x)
    col, row = (np.floor(np.where(seen, c, -1)).astype(np.int64) for c in to_cell * (x, y))
    seen &= (row >= 0) & (col >= 0) & (row < bits.shape[0]) & (col < bits.shape[1])
    return np.asarray(seen & (bits[np.where(seen, row, 0), np.where(seen, col, 0)] > 0), np.bool_)


def _index(folder: Path) -> _Index:
    file = folder / "frames.json"
    try:
        return _Index.model_validate_json(read_text(file, LARGEST_INDEX, RecordingError))
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()[:3])
        raise RecordingError(
            f"{file}: no index of simulated frames ({found}); `ltm-lab simulate` writes one"
        ) from error


def _frame(index: _Index) -> SiteFrame:
    return SiteFrame(index.crs, *index.origin)
