"""Trace the ray of each pixel to the terrain; cache horizon profiles and ranges between frames.

Source: Algorithm 1 (pixel-based on-raster ray tracing) of the LTM paper, made exact: each ray is intersected with the
bilinear surface, and earth curvature and refraction bend it (docs/how/tracing.md).

**The answer** for a ray is

* the range to the first point where it is on or below known ground;
* NaN (unknown) if, before that but after it has been over known ground, it comes as low as unknown ground may be high;
  and NaN if it comes into known ground from outside the DEM already below the surface;
* +inf (sky) if it meets no ground and leaves the raster while it climbs against the local horizon,
  and is there above `highest`, or climbs by `steepest` or more, so that no ground ahead can reach it. Else NaN. A ray
  that has never been over known ground is judged at the camera.

`trace` uses the horizon profile of the camera's position (`horizon_profile`, `column_sweep`), which is kept; rays where
a profile cannot help use the maximum pyramid (`pyramid_traversal`). Both give the same answer for every ray."""

import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import PoseError
from ltm_core.base.kernels import in_parallel
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem
from ltm_core.tracing.column_sweep import sweep_image
from ltm_core.tracing.horizon_profile import SECTOR, WEDGES_A_FACE, Wedges, extended, mark_sectors, no_wedges
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_core.tracing.pyramid_traversal import FRESH, OVER_KNOWN, trace_directions
from ltm_core.tracing.raster_stages import filled_corners, grounds, stages

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class TracerStatistics:
    """Counts since the tracer was created, and the bytes of its caches. `frame_hits`: camera and pose were as before,
    so nothing was traced; `profile_hits`: the position's profile was complete."""

    frames: int
    frame_hits: int
    profile_hits: int
    profile_bytes: int
    frame_bytes: int


class BoundedCache(Generic[_Value]):
    """Cache of values by key that evicts the least recently used ones when the total, `held_bytes`, exceeds
    `most_bytes`. Thread-safe."""

    def __init__(self, most_bytes: int, size_of: Callable[[_Value], int]) -> None:
        self._most = most_bytes
        self._size_of = size_of
        self._values: OrderedDict[Hashable, _Value] = OrderedDict()
        self.held_bytes = 0
        self._lock = threading.Lock()

    def get(self, key: Hashable) -> _Value | None:
        """Return the value and mark it as used; None if it is missing."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key]

    def put(self, key: Hashable, value: _Value, usual: int | None = None) -> None:
        """Keep or replace a value; one that alone exceeds the bound is not kept. `usual`: bytes above which no other is
        kept beside it; None: the bound."""
        most = self._most if usual is None else min(self._most, max(usual, self._size_of(value)))
        with self._lock:
            if key in self._values:
                self.held_bytes -= self._size_of(self._values.pop(key))
            self._values[key] = value
            self.held_bytes += self._size_of(value)
            while self.held_bytes > most:
                _, oldest = self._values.popitem(last=False)
                self.held_bytes -= self._size_of(oldest)


# Fewer pixels than this do not repay the profile of a position that may never be seen again.
_FEW_PIXELS = 40_000
_MARK_EVERY = 8  # pixels
_FEWEST_RAYS = 2048
"""Minimum number of rays for a thread."""
PROFILE_BYTES = 64 * 2**20
FRAME_BYTES = 48 * 2**20
_OF_ALL = 4
"""Number of tracers of a process that may fill their caches. If more of them cache, each has a share of that; the last
profile and the last frame of each stay."""

Way = Literal["auto", "profile", "pyramid"]
Profile = tuple[Wedges, ...]
"""Profile of each level of the DEM."""


class TerrainTracer:
    """Traces images over one DEM.

    `dem`: the terrain, in the frame of the poses; adds a twelfth of its memory, once for all its tracers. `curvature`:
    bend rays for the earth's curvature and refraction. `refraction`: coefficient k; 0.13 is the surveyors' daytime
    mean. `possible`: maximum height of unknown ground. Raises RasterError for a DEM with infinite heights."""

    def __init__(
        self, dem: Dem, curvature: bool = True, refraction: float = 0.13, possible: PossibleGround = PossibleGround()
    ) -> None:
        self.dem = dem
        self.bend = ray_bend(curvature, refraction)
        self.possible = possible
        self._grounds, highest = grounds(dem, possible)
        self._beyond = possible.steepest, highest
        self._profiles = BoundedCache[Profile](PROFILE_BYTES, _bytes)
        self._place: Hashable = None
        """Position of the last traced image."""
        self._frames = BoundedCache[Float32Array](FRAME_BYTES, lambda ranges: ranges.nbytes)
        self._counts = np.zeros(3, np.int64)  # frames, frame hits, profile hits
        self._lock = threading.Lock()

    @property
    def statistics(self) -> TracerStatistics:
        """Return cache hits and sizes."""
        frames, frame_hits, profile_hits = self._counts.tolist()
        held = self._profiles.held_bytes, self._frames.held_bytes
        return TracerStatistics(frames, frame_hits, profile_hits, *held)

    def trace(self, camera: Camera, pose: Pose, way: Way = "auto") -> RangeImage:
        """Return the range of every pixel; the array is read-only, because it is returned again for the same camera and
        pose. `way`: "profile" or "pyramid" forces one, if possible, and keeps no frame, "pyramid" nothing at all.

        Raises PoseError if the pose is not finite, the camera is not above the ground, or it is in an enclosed hole of
        the DEM, below the ground around it."""
        seen = (camera, pose.position.tobytes(), pose.rotation.tobytes(), self.bend)
        ranges = self._frames.get(seen) if way == "auto" else None
        frame_hit, profile_hit = ranges is not None, False
        if way != "pyramid":
            _caching.add(self)
        if ranges is None:
            self._check(pose.position, pose.rotation)
            profile_hit, ranges = self._trace_image(camera, pose, way)
            ranges.flags.writeable = False
            if way == "auto":
                self._frames.put(seen, ranges, _share(FRAME_BYTES))
        with self._lock:
            self._counts += (1, frame_hit, profile_hit)
        return RangeImage(ranges, camera, pose, self.bend, self.dem.geometry)

    def _trace_image(self, camera: Camera, pose: Pose, way: Way) -> tuple[bool, Float32Array]:
        """Return whether the profile was there, and the ranges (H, W)."""
        rays = camera.rays()
        place = (pose.position.tobytes(), self.bend)
        kept = self._profiles.get(place)
        few = way == "auto" and kept is None and camera.width * camera.height < _FEW_PIXELS
        # A profile needs a position over the finest raster, and in no outer hole.
        around = filled_corners(self.dem.levels[0], self._grounds[0], pose.position)
        if way == "pyramid" or few or around is None or np.isnan(around).any():
            flat = self._trace(pose.position, pose.rotation, rays.reshape(-1, 3))
            return False, flat.reshape(camera.height, camera.width)
        rotation = np.ascontiguousarray(pose.rotation, np.float64)
        ranges = np.full((camera.height, camera.width), OVER_KNOWN, np.float32)
        profile: list[Wedges] = []
        marked = np.zeros(4 * WEDGES_A_FACE // SECTOR, np.bool_)
        mark_sectors(rays, rotation, _MARK_EVERY, marked)
        wanted = (np.flatnonzero(marked)[:, None] * SECTOR + np.arange(SECTOR)).ravel()
        for level, stage in stages(self.dem, pose.position, self.bend, *self._beyond):
            before = no_wedges() if kept is None else kept[level]
            profile.append(extended(before, wanted, self._grounds[level], stage))
            sweep_image(self._grounds[level], stage, profile[-1], rotation, rays, ranges)
        whole = kept is not None and all(a is b for a, b in zip(kept, profile, strict=True))
        # Of many cameras, one that stands still keeps its frame, and would never use its profile again.
        if not whole and (place == self._place or _bytes(profile) <= _share(PROFILE_BYTES)):
            self._profiles.put(place, tuple(profile), _share(PROFILE_BYTES))
        self._place = place
        return whole, ranges

    def trace_rays(self, origin: ArrayLike, directions: ArrayLike) -> Float32Array:
        """Return the slant range in metres of rays from one origin (3,), (N,) float32. `directions`: (N, 3) x, y, z of
        any length; a zero or non-finite one gives NaN. Raises PoseError as `trace`."""
        rays = np.ascontiguousarray(directions, np.float64)
        if rays.ndim != 2 or rays.shape[1] != 3:
            raise PoseError(f"ray directions must be (N, 3), got {rays.shape}")
        with np.errstate(invalid="ignore", divide="ignore"):
            rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        rays.flags.writeable = False  # as a camera's are: one compiled kernel serves both
        position = np.asarray(origin, np.float64)
        self._check(position, np.eye(3))
        return self._trace(position, np.eye(3), rays)

    def _trace(self, origin: Float64Array, rotation: Float64Array, rays: Float64Array) -> Float32Array:
        ranges = np.full(len(rays), FRESH, np.float32)
        turned = np.ascontiguousarray(rotation, np.float64)
        passed = stages(self.dem, origin, self.bend, *self._beyond)

        def trace(begin: int, end: int) -> None:
            part = slice(begin, end)
            for number, (level, stage) in enumerate(passed):
                trace_directions(self._grounds[level], stage, turned, rays[part], number == 0, ranges[part])

        in_parallel(trace, len(rays), _FEWEST_RAYS)
        return ranges

    def _check(self, origin: Float64Array, rotation: Float64Array) -> None:
        if origin.shape != (3,) or not np.isfinite(origin).all() or not np.isfinite(rotation).all():
            raise PoseError(f"camera pose is not finite: position {origin.tolist()}, rotation {rotation.tolist()}")
        x, y, z = (float(v) for v in origin)
        clearance = z - float(self.dem.elevation_at(x, y))
        if clearance <= 0.0:
            raise PoseError(
                f"camera at ({x:.2f}, {y:.2f}, {z:.2f}) is {abs(clearance):.2f} m under the ground, which is at "
                f"{z - clearance:.2f} m: check its height, the vertical datum (ellipsoidal or geoid) and the position"
            )
        levels = zip(self.dem.levels, self._grounds, strict=True)
        around = next((f for level, of in levels if (f := filled_corners(level, of, origin)) is not None), None)
        ceiling = np.nan if around is None else float(around.max())  # NaN in an outer hole, too
        if clearance != clearance and z <= ceiling:
            raise PoseError(
                f"camera at ({x:.2f}, {y:.2f}, {z:.2f}) is in a nodata hole of the DEM, {ceiling - z:.2f} m below "
                f"the highest ground around it ({ceiling:.2f} m): fill the hole, or raise the camera above it"
            )


_caching: weakref.WeakSet[TerrainTracer] = weakref.WeakSet()


def _bytes(profile: Sequence[Wedges]) -> int:
    return sum(array.nbytes for wedges in profile for array in wedges)


def _share(most_bytes: int) -> int:
    return _OF_ALL * most_bytes // max(_OF_ALL, len(_caching))
