"""Find the photos that show a sampled cell best, from different days and cameras, and its outline in them."""

from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.label_heads.labelled_frames import evenly
from ltm_core.pictures import to_jpeg
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.visibility.footprint import arrival_directions, ground_normals
from ltm_core.visibility.point_visibility import PointVisibility, in_image, project
from ltm_core.vision.usable import judge
from ltm_msgs_py.bag.reader import is_bag_file
from ltm_ros.archive.scan import files_below
from ltm_ros.assessment.answers_io import SampledCell
from ltm_ros.recordings.frame_stream import PARTS, FrameStream, StreamedFrame

MOST_FRAMES: Final = 600
"""Photos of all recordings that are kept, evenly in time; JPEGs of 2 megapixels need 0.5 MB each."""
PHOTOS: Final = 3
"""Photos shown for a cell."""
_DAY_NS = 86400 * 10**9
_TOLERANCE_M = 1.0
"""Metres by which a part of the cell may be hidden: the surface is known to about a metre."""
_LEAST_SHARE = 0.3
"""Visible share of a cell's parts below which a photo does not show it."""
_SAME_CAMERA, _SAME_DAY = 0.5, 0.7
"""Factors on the value of a further photo of the same camera, and of the same day."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A clear photo. `pose`: map frame."""

    camera_name: str
    stamp_ns: int
    camera: Camera
    pose: Pose
    jpeg: bytes


@dataclass(frozen=True, eq=False)
class CellPhoto(Shot):
    """A photo that shows a cell. `outline`: (N, 2) the cell's edge in pixels (u, v). `range_m`: distance of the cell's
    centre; `incidence_deg`: angle between the line of sight and the ground's normal."""

    outline: Float64Array
    range_m: float
    incidence_deg: float


class PhotoIndex:
    """The clear photos of recordings, or of an archive's, in folders at any depth, with their poses. Raises
    RecordingError if there are none."""

    def __init__(self, site: Site, recordings: Sequence[Path]) -> None:
        self._frame = site.frame
        self._ground = site.open_dem()
        self._sight = PointVisibility(site.open_surface(self._ground), site.curvature, site.refraction)
        bags = evenly([bag for path in recordings for bag in _bags(path)], MOST_FRAMES)
        self._shots = [shot for bag in bags for shot in _shots(bag, site, self._ground, MOST_FRAMES // len(bags))]
        if not self._shots:
            names = ", ".join(str(bag) for bag in recordings)
            raise RecordingError(f"{names}: no clear photo with a pose of the cameras of site {site.name}")

    def best(self, cell: SampledCell, cell_m: float) -> list[CellPhoto]:
        """Return up to three photos of a cell in order of time: of early and late days, and of different cameras. A
        photo's value is the square root of the visible area of the cell in pixels: that includes range, incidence and
        zoom. Photos that are blurred, dark or foggy are not in the index."""
        side, third = np.linspace(-0.5, 0.5, 7)[:-1], np.array([-1.0, 0.0, 1.0]) / 3
        half = np.full(6, 0.5)
        east, north = np.concatenate([side, half, -side, -half]), np.concatenate([half, -side, -half, side])
        edge = self._points(self._ground, cell, cell_m * np.column_stack([east, north]))
        parts = self._points(self._sight.dem, cell, cell_m * np.stack(np.meshgrid(third, third), -1).reshape(-1, 2))
        if np.isnan(parts).any() or np.isnan(edge).any():
            return []
        middle = parts[len(parts) // 2]
        normal = ground_normals(self._ground, middle[0], middle[1], self._ground.geometry.resolution / 2)
        visible = self._visible(parts)
        found = []
        for shot in self._shots:
            pixels = project(shot.camera, shot.pose, parts, self._sight.bend)
            share = float((visible[_place(shot.pose)] & in_image(shot.camera, pixels)).mean())
            outline = project(shot.camera, shot.pose, edge, self._sight.bend)
            if share >= _LEAST_SHARE and np.isfinite(outline).all():
                found.append((share * _area(outline) ** 0.5, shot, outline))
        chosen = []
        for _value, shot, outline in _different(found):
            away = arrival_directions(shot.pose.position, middle, self._sight.bend)
            incidence = float(np.degrees(np.arccos(np.clip(-(away * normal).sum(), -1, 1))))
            distance = float(np.linalg.norm(middle - shot.pose.position))
            chosen.append(CellPhoto(**vars(shot), outline=outline, range_m=distance, incidence_deg=incidence))
        return chosen

    def _points(self, over: Dem, cell: SampledCell, offsets: Float64Array) -> Float64Array:
        """Return points (N, 3) on a surface at offsets (N, 2) in metres from a cell's centre; map frame."""
        x, y = cell.x - self._frame.x_origin + offsets[:, 0], cell.y - self._frame.y_origin + offsets[:, 1]
        return np.column_stack([x, y, over.elevation_at(x, y)])

    def _visible(self, parts: Float64Array) -> dict[tuple[float, ...], np.ndarray]:
        """Return for each place of a camera which parts the terrain does not hide; lines of sight are traced once."""
        found = {_place(shot.pose): np.zeros(len(parts), np.bool_) for shot in self._shots}
        for place in found:
            with suppress(LtmError):  # a pose below the ground
                lifts, unknown = self._sight.lifts(place, parts)
                found[place] = (lifts <= _TOLERANCE_M) & ~unknown
        return found


def _place(pose: Pose) -> tuple[float, ...]:
    return tuple(float(value) for value in pose.position)


def _area(outline: Float64Array) -> float:
    u, v = outline[:, 0], outline[:, 1]
    return abs(float(np.dot(u, np.roll(v, 1)) - np.dot(v, np.roll(u, 1)))) / 2


_Found = tuple[float, Shot, Float64Array]


def _different(found: Sequence[_Found]) -> list[_Found]:
    """Return up to PHOTOS candidates in order of time. If they are of several days, the first and the last third of the
    time each give one, so that a change shows."""
    if not found:
        return []
    stamps = [shot.stamp_ns for _, shot, _ in found]
    first, span = min(stamps), max(stamps) - min(stamps)
    periods = [found]
    if max(stamps) // _DAY_NS > first // _DAY_NS:
        early = [one for one in found if one[1].stamp_ns <= first + span / 3]
        late = [one for one in found if one[1].stamp_ns >= first + span * 2 / 3]
        periods = [late, early, found]
    chosen: list[_Found] = []

    def value(one: _Found) -> float:
        same_camera = sum(other[1].camera_name == one[1].camera_name for other in chosen)
        same_day = sum(other[1].stamp_ns // _DAY_NS == one[1].stamp_ns // _DAY_NS for other in chosen)
        return one[0] * _SAME_CAMERA**same_camera * _SAME_DAY**same_day

    for number in range(PHOTOS):
        rest = [one for one in periods[min(number, len(periods) - 1)] if one not in chosen]
        if rest:
            chosen.append(max(rest, key=value))
    return sorted(chosen, key=lambda one: one[1].stamp_ns)


def _bags(path: Path) -> list[Path]:
    """Return the folders with bags in an archive; a path without any itself, so that its reader reports it."""
    below = files_below(path) if path.is_dir() else []
    return sorted({file.parent for file in below if is_bag_file(file.name)}) or [path]


def _shots(bag: Path, site: Site, dem: Dem, most: int) -> list[Shot]:
    """Return a recording's clear photos; of more than `most`, evenly chosen ones of each camera."""
    stream = FrameStream(bag, site, {part: PARTS[part] for part in ("photo", "camera", "pose")})
    fixed = {name: c.pose.pose(dem, site.frame) for name, c in site.cameras.items() if c.pose is not None}
    cameras: dict[str, Camera] = {
        name: config.calibration.camera() for name, config in site.cameras.items() if config.calibration is not None
    }
    stamps: dict[str, list[int]] = defaultdict(list)
    for frame in stream.frames(("photo",)):
        name = frame.camera_name
        if name not in cameras and (camera := _taken(frame, "camera")) is not None:
            cameras[name] = camera
        if "pose" in frame or name in fixed:
            stamps[name].append(frame.stamp_ns)
    wanted = {(name, stamp) for name, of in stamps.items() for stamp in evenly(of, max(1, most // len(stamps)))}
    found = []
    for frame in stream.frames(("photo",)):
        name = frame.camera_name
        if (name, frame.stamp_ns) not in wanted or name not in cameras:
            continue
        photo, pose = _taken(frame, "photo"), _taken(frame, "pose") or fixed.get(name)
        if photo is None or pose is None or judge(photo).reason is not None:
            continue
        camera = _taken(frame, "camera") or cameras[name]  # the zoom of this frame
        if photo.shape[:2] != (camera.height, camera.width):
            camera = camera.resized(photo.shape[1], photo.shape[0])
        found.append(Shot(name, frame.stamp_ns, camera, pose, to_jpeg(photo, quality=92)))
    return found


def _taken(frame: StreamedFrame, part: str) -> Any:
    """Return a part of a frame; None if it is missing or damaged."""
    try:
        return frame.take(part)
    except LtmError:
        return None
