"""Reads the frames of a folder of `ltm-lab simulate` with their truth."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem
from ltm_core.storage.config_io import load_arrays, read_text
from ltm_core.storage.image_io import read_rgb

LARGEST_INDEX = 64 << 20
"""Bytes of `frames.json`: a frame takes one thousand."""
_LARGEST_TRUTH = 1 << 30
"""Bytes of an array of a frame's truth."""


Value = TypeVar("Value")


@dataclass(frozen=True)
class Report:
    """What the sensors said of a frame; `covariance`: the diagonal of (6, 6) of the pose."""

    stamp_ns: int
    received_ns: int
    pose: Pose
    covariance: tuple[float, ...] = (0.0,) * 6


class TruthFrame:
    """A photo with its truth at every `step`-th pixel, from the first.

    `photo`: (H, W, 3). `surface`, `ground`: depth along the optical axis of the visible surface and of bare ground,
    (h, w) metres, +inf sky. `labels`: class ids (h, w). `changed`: whether ground or vegetation differ from the time
    of the DEM, (h, w). Each array can be given as a function, which is called when the array is first used.
    `reported`: what the sensors said; by default the truth.
    """

    def __init__(
        self,
        camera_name: str,
        stamp_ns: int,
        camera: Camera,
        pose: Pose,
        photo: UInt8Array | Callable[[], UInt8Array],
        surface: Float32Array | Callable[[], Float32Array],
        ground: Float32Array | Callable[[], Float32Array],
        labels: UInt8Array | Callable[[], UInt8Array],
        changed: BoolArray | Callable[[], BoolArray],
        date: str = "",
        reported: Report | None = None,
    ) -> None:
        self.camera_name, self.stamp_ns, self.camera, self.pose, self.date = camera_name, stamp_ns, camera, pose, date
        self.reported = Report(stamp_ns, stamp_ns, pose) if reported is None else reported
        self._photo, self._surface, self._ground, self._labels, self._changed = photo, surface, ground, labels, changed

    @cached_property
    def photo(self) -> UInt8Array:
        return _loaded(self._photo)

    @cached_property
    def surface(self) -> Float32Array:
        return _loaded(self._surface)

    @cached_property
    def ground(self) -> Float32Array:
        return _loaded(self._ground)

    @cached_property
    def labels(self) -> UInt8Array:
        return _loaded(self._labels)

    @cached_property
    def changed(self) -> BoolArray:
        return _loaded(self._changed)

    @property
    def step(self) -> int:
        across: int = self.surface.shape[1]
        return round(self.camera.width / across)


def _loaded(value: Value | Callable[[], Value]) -> Value:
    return value() if callable(value) else value


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


class _PoseEntry(_Lenient):
    stamp_ns: int
    position: tuple[float, float, float]
    azimuth_deg: float
    pitch_deg: float
    roll_deg: float

    def pose(self) -> Pose:
        return Pose.from_angles(self.position, self.azimuth_deg, self.pitch_deg, self.roll_deg)


class _ReportEntry(_PoseEntry):
    received_ns: int | None = None
    covariance: tuple[float, float, float, float, float, float] = (0.0,) * 6

    def report(self) -> Report:
        received = self.stamp_ns if self.received_ns is None else self.received_ns
        return Report(self.stamp_ns, received, self.pose(), self.covariance)


class _FrameEntry(_PoseEntry):
    camera_name: str
    image: str = Field(pattern=r"^[\w./-]+$")
    truth: str = Field(pattern=r"^[\w./-]+$")
    camera: _CameraEntry
    truth_camera: _CameraEntry
    date: str = Field("", pattern=r"^[\w.-]*$")
    reported: _ReportEntry | None = None


class _Date(_Lenient):
    name: str = Field(pattern=r"^[\w.-]*$")


class _Walk(_Lenient):
    name: str
    geoid_undulation: float


class SimulationIndex(_Lenient):
    """The parts of `frames.json` that are read here."""

    scenario: str
    crs: str
    origin: tuple[float, float]
    curvature: bool
    truth_step: int = Field(1, ge=1)
    jpeg_quality: int = 78
    dates: list[_Date] = Field(default_factory=list)
    walks: list[_Walk] = Field(default_factory=list)
    frames: list[_FrameEntry]

    @property
    def site_frame(self) -> SiteFrame:
        return SiteFrame(self.crs, *self.origin)


def open_dem(folder: Path) -> Dem:
    """The outdated DEM of a folder of `ltm-lab simulate`, in the map frame. Raises RecordingError, RasterError."""
    return Dem.open(folder / "dem.tif").in_frame(site_frame(folder))


def site_frame(folder: Path) -> SiteFrame:
    """Return the map frame of a folder. Raises RecordingError."""
    return read_index(folder).site_frame


def scenario_name(folder: Path) -> str:
    """Return the name of the scenario that a folder shows. Raises RecordingError."""
    return read_index(folder).scenario


def is_curved(folder: Path) -> bool:
    """Return whether the earth's curvature is in the scene of a folder. Raises RecordingError."""
    return read_index(folder).curvature


def dates(folder: Path) -> list[str]:
    """Return the names of a folder's dates; empty if it has one only. Raises RecordingError."""
    return [date.name for date in read_index(folder).dates]


def read_truth_frames(folder: Path, date: str = "") -> Iterator[TruthFrame]:
    """Return the frames of a folder, of one date if it has several (empty: all).

    Pictures and truth are read when they are first used. Raises RecordingError, also then.
    """
    index = read_index(folder)
    first = next((d.name for d in index.dates), "")
    for entry in index.frames:
        if not date or entry.date == date:
            yield _frame(folder, index, entry, folder / "truth" / f"change_{first}_{entry.date}.tif")


def _frame(folder: Path, index: SimulationIndex, entry: _FrameEntry, change: Path) -> TruthFrame:
    camera, sampled, pose = entry.camera.camera(), entry.truth_camera.camera(), entry.pose()
    bend = ray_bend(index.curvature, 0.13)

    @cache
    def truth() -> tuple[RangeImage, RangeImage, UInt8Array]:
        names = "range_surface", "range_ground", "labels"
        try:
            *ranges, ids = load_arrays(folder / entry.truth, names, _LARGEST_TRUTH, RecordingError)
            surface, ground = (RangeImage(values.astype(np.float32), sampled, pose, bend) for values in ranges)
            return surface, ground, ids.astype(np.uint8)
        except (RecordingError, ValueError) as error:
            raise RecordingError(f"{folder / entry.truth}: no truth of the frame ({error}); render it again") from error

    def changed() -> BoolArray:
        surface, _, labels = truth()
        return _changed(surface, change, index.site_frame) if change.is_file() else np.zeros(labels.shape, np.bool_)

    return TruthFrame(
        entry.camera_name,
        entry.stamp_ns,
        camera,
        pose,
        lambda: _photo(folder / entry.image),
        lambda: truth()[0].depth(),
        lambda: truth()[1].depth(),
        lambda: truth()[2],
        changed,
        entry.date,
        None if entry.reported is None else entry.reported.report(),
    )


def _photo(path: Path) -> UInt8Array:
    if not path.is_file():
        raise RecordingError(f"{path}: the frame's picture is missing; render it again")
    return read_rgb(path)


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


def read_index(folder: Path) -> SimulationIndex:
    """Read `frames.json` of a folder of `ltm-lab simulate`. Raises RecordingError."""
    file = folder / "frames.json"
    if not file.is_file():
        raise RecordingError(f"{file}: no index of simulated frames; `ltm-lab simulate` writes one")
    try:
        return SimulationIndex.model_validate_json(read_text(file, LARGEST_INDEX, RecordingError))
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()[:3])
        raise RecordingError(
            f"{file}: no index of simulated frames ({found}); `ltm-lab simulate` writes one"
        ) from error
