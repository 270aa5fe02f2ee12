"""Convert depth images to observations of surface heights."""

import math
import mmap
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, RecordArray, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, checked_covariance
from ltm_core.surface.cell_layout import TILE, FrameSums, clear, sum_of
from ltm_core.surface.observation_kernel import ObservationLimits, Pixels, observe
from ltm_core.surface.reference_surface import (
    BLOCK,
    EXPECTED_PIXEL,
    CameraView,
    Extremes,
    Reference,
    ReferenceGrid,
    predict_view,
    stood_at,
)
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.tracer import BoundedCache

_EDGE = 0.5
"""Share of the height of an object within which neighbouring pixels may see it differently."""


@kernel()
def add_labels(
    ground: ReferenceGrid,
    expected_pixels: RecordArray,
    ids: UInt8Array,
    cosines: Float32Array,
    gone: Float32Array,
    depth: Pixels,
    limits: ObservationLimits,
    sums: FrameSums,
) -> None:
    """Add the label evidence of labels (H, W) by cell, as far as `sums` has room.

    `expected_pixels`: the reference's view of these pixels; `cosines`: their depth / slant range. `gone`: (256,) log
    odds by label that what stood is gone. `depth`: the measurement in the same photo, at its own size. Labels at an
    edge do not count, because they may be of what is beside it."""
    rows, cols = ids.shape
    height, width = depth.depth.shape
    for v in range(rows):
        below = v * height // rows
        for u in range(cols):
            odds, pixel = gone[ids[v, u]], expected_pixels[v, u]
            if odds == 0.0 or pixel.place < 0 or not limits.min_range < pixel.expected < limits.max_range:
                continue
            stood = stood_at(ground, pixel.place)
            if not stood >= limits.stands or pixel.spread * pixel.incidence > _EDGE * stood:
                continue
            across = u * width // cols
            if depth.informs[below, across]:
                farthest = depth.depth[below, across] + limits.gate * depth.sigma[below, across]
                if farthest < pixel.nearest * cosines[v, u]:
                    continue
            number = sum_of(sums, pixel.place)
            if number < 0:
                continue
            one = sums.cells[number]
            one.stood = stood
            one.labelled += 1.0
            one.gone += max(odds, np.float32(0.0))
            one.stays += max(-odds, np.float32(0.0))
            one.labelled_pose += pixel.pose_variance


_WIDEST_WINDOW = 24
"""Maximum window in pixels; if a pose is so uncertain that a silhouette may lie further off, silhouettes carry no
information."""


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """One posed depth image.

    `depth`, `sigma`: (H, W) float32 metres along the optical axis; depth +inf sky, NaN unknown. `measured`: (H, W)
    bool, where depth is a measurement; False where it was copied from the terrain, which then says nothing of it.
    `labels`: (H, W) uint8 class ids or None. `covariance`: (6, 6) of the pose over x, y, z (m) and rotations about the
    map's axes (rad); None: not known. `stable`: (H, W) bool, open ground that does not grow, where the frame itself
    tells it, or None. `full_labels`: labels at their own size, of which the map asks what still stands, and the camera
    of an image of that size, or None. Raises ImageError where shapes differ, PoseError for a covariance that is none.
    """

    depth: Float32Array
    sigma: Float32Array
    measured: BoolArray
    camera: Camera
    pose: Pose
    stamp_ns: int
    source: str
    covariance: Float64Array | None = None
    labels: UInt8Array | None = None
    stable: BoolArray | None = None
    full_labels: tuple[UInt8Array, Camera] | None = None

    @classmethod
    def of_photo(
        cls,
        depth: Float32Array,
        sigma: Float32Array,
        camera: Camera,
        pose: Pose,
        stamp_ns: int,
        source: str,
        covariance: Float64Array | None = None,
        labels: UInt8Array | None = None,
    ) -> "DepthFrame":
        """Return the frame of a measurement in a photo of `camera`, NaN where nothing was measured, and its labels:
        each of its own size, edge to edge over the photo. If nothing was measured, the pose may be suspected, and
        labels are not used."""
        height, width = depth.shape
        measured = ~np.isnan(depth)
        small = full_labels = None
        if labels is not None:
            small = np.asarray(cv2.resize(labels, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
            if measured.any():
                full_labels = labels, camera.resized(labels.shape[1], labels.shape[0])
        own = camera.resized(width, height)
        return cls(depth, sigma, measured, own, pose, stamp_ns, source, covariance, small, None, full_labels)

    def __post_init__(self) -> None:
        names = ("depth", "sigma", "measured", "labels", "stable")
        images = [(name, getattr(self, name), self.camera) for name in names]
        for name, array, camera in [*images, ("full label", *(self.full_labels or (None, self.camera)))]:
            shape = (camera.height, camera.width)
            if array is not None and array.shape != shape:
                raise ImageError(f"{name} image of {array.shape} does not fit a camera of {shape} (rows, columns)")
        if self.covariance is not None:
            checked_covariance(self.covariance)


class Observer:
    """Convert depth images to observations of a reference surface. `columns`: maximum number of columns of a frame.
    `views_mb`: memory for the expected views of fixed cameras. `gone`: (256,) log odds by label id that what stood in a
    cell is gone; None: labels are not used."""

    def __init__(
        self,
        reference: Reference,
        tracer: TerrainTracer,
        limits: ObservationLimits,
        columns: int,
        views_mb: float = 0.0,
        gone: Float32Array | None = None,
    ) -> None:
        geometry = reference.geometry
        tiles = [-(-n // TILE) for n in geometry.shape]
        corner = geometry.x_min, geometry.y_max, geometry.resolution
        self._ground = ReferenceGrid(reference.surface, reference.bare, *reference.slopes, BLOCK, *corner, tiles[1])
        self._tracer, self._limits, self._columns = tracer, limits, columns
        self._gone = np.zeros(256, np.float32) if gone is None else gone
        self._tiles = tiles[0] * tiles[1]
        self._sums = FrameSums.empty(0, self._tiles)
        self._views = BoundedCache[RecordArray](int(views_mb * 2**20), lambda pixels: pixels.nbytes)

    def observe(self, frame: DepthFrame, covariance: Float64Array) -> FrameSums:
        """Return the observations of a frame by cell, valid until the next call. Raises PoseError as the tracer
        does."""
        ids, camera = np.empty((0, 0), np.uint8), self.sampled(frame)
        if frame.full_labels is not None and self._gone.any():
            labels, label_camera = frame.full_labels
            step = -(-label_camera.width // self._columns)
            ids, label_camera = np.ascontiguousarray(labels[::step, ::step]).view(), label_camera.scaled(step)
            ids.flags.writeable = False  # as a message's are: one compiled kernel serves both
        view, expected_pixels = self._expected_pixels(camera, frame, covariance)
        if len(self._sums.cells) < 2 * expected_pixels.size + ids.size:
            self._sums = FrameSums.empty(2 * expected_pixels.size + ids.size, self._tiles)
        clear(self._sums)
        pixels = self.pixels(frame)
        used = frame.depth[:: pixels.step, :: pixels.step]
        beside = _extremes(np.where(np.isnan(used), np.float32(np.inf), used), 1)[0]
        observe(self._ground, view, expected_pixels, pixels, beside, self._limits, self._sums)
        if ids.size:
            _, expected_pixels = self._expected_pixels(label_camera, frame, covariance)
            known = label_camera.cosines(), self._gone, pixels, self._limits, self._sums
            add_labels(self._ground, expected_pixels, ids, *known)
        return self._sums

    def sampled(self, frame: DepthFrame) -> Camera:
        """Return the camera of the pixels of a frame that are used."""
        return frame.camera.scaled(self._step(frame))

    def _step(self, frame: DepthFrame) -> int:
        return -(-frame.camera.width // self._columns)

    def pixels(self, frame: DepthFrame) -> Pixels:
        """Return a frame in its compiled form."""
        return Pixels(
            np.ascontiguousarray(frame.depth, np.float32),
            np.ascontiguousarray(frame.sigma, np.float32),
            np.ascontiguousarray(frame.measured).view(np.uint8),
            self._step(frame),
            self.sampled(frame).cosines(),
        )

    def _expected_pixels(
        self, camera: Camera, frame: DepthFrame, covariance: Float64Array
    ) -> tuple[CameraView, RecordArray]:
        """Return the view, and what the reference has for its pixels (H, W), which it need not be asked twice."""
        rotation, position = np.ascontiguousarray(frame.pose.rotation), np.ascontiguousarray(frame.pose.position)
        view = CameraView(camera.rays(), rotation, position, np.ascontiguousarray(covariance), self._tracer.bend)
        key = (camera, view.rotation.tobytes(), view.position.tobytes(), view.covariance.tobytes())
        expected_pixels = self._views.get(key)
        if expected_pixels is None:
            expected = self._tracer.trace(camera, frame.pose).range
            turn = math.sqrt(float(np.linalg.eigvalsh(view.covariance[3:, 3:])[-1]))
            window = min(1 + math.ceil(self._limits.gate * turn * camera.fx), _WIDEST_WINDOW)
            known = np.where(np.isnan(expected), np.float32(np.inf), expected)
            near = _extremes(known, 1)
            widest = near if window == 1 else _extremes(known, window)
            # A mapping of its own: on the heap, arrays of this size would fragment the memory.
            room = mmap.mmap(-1, expected.size * EXPECTED_PIXEL.itemsize)
            expected_pixels = np.frombuffer(room, EXPECTED_PIXEL).reshape(expected.shape)
            predict_view(self._ground, view, expected, Extremes(*widest, *near), expected_pixels)
            self._views.put(key, expected_pixels)
        return view, expected_pixels


def _extremes(ranges: Float32Array, radius: int) -> tuple[Float32Array, Float32Array]:
    """Return the least and greatest range within `radius` pixels."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.asarray(cv2.erode(ranges, kernel), np.float32), np.asarray(cv2.dilate(ranges, kernel), np.float32)
