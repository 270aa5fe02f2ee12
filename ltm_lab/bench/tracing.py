"""Time our tracer and its peers on the same views of the same mountains, each in a process of its own.

Ours is timed in three states: `cold`, from a position that no camera had before; `warm`, another view from the same
position; and `still`, the same camera and pose again.
"""

import itertools
import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_lab.bench.measure import Cost, available_mb, cost_of, in_own_process, least_cost, peak_mb, resident_mb
from ltm_lab.bench.mountains import ridged_terrain
from ltm_lab.bench.peers import PEERS, PeerKind, TracedView

OURS = "ours"
TRACERS = (OURS, *(peer.name for peer in PEERS))
_MAST_M = 10.0


@dataclass(frozen=True)
class Scene:
    """An image size and a field of view."""

    name: str
    width: int
    height: int
    hfov_deg: float

    def camera(self, every: int = 1) -> Camera:
        """Return a camera with some distortion that has every `every`-th pixel."""
        camera = Camera.from_fov(self.width, self.height, self.hfov_deg)
        return replace(camera, distortion=(-0.06, 0.01, 0.0, 0.0, 0.0)).scaled(every)


SCENES = tuple(
    Scene(f"{size} {fov} deg", width, height, float(fov))
    for size, width, height in (("1080p", 1920, 1080), ("VGA", 640, 480))
    for fov in (60, 5)
)


@dataclass(frozen=True)
class TracerCost:
    """Costs of one tracer on a DEM of `size` x `size` cells.

    `frames` holds the cost of a frame by scene and state; a peer has the single state "". `memory_mb` is the peak
    beyond the DEM.
    """

    tracer: str
    size: int
    setup: Cost
    memory_mb: float
    frames: dict[str, dict[str, Cost]]


@dataclass(frozen=True)
class Skipped:
    """A tracer that was not run, and the reason."""

    tracer: str
    size: int
    reason: str


def bench_pose(dem: Dem) -> Pose:
    """Return a pose 10 m above the highest summit of the raster's inner half, towards the farthest corner."""
    height, width = dem.elevation.shape
    inner = dem.elevation[height // 4 : height - height // 4, width // 4 : width - width // 4]
    row, col = np.unravel_index(int(np.argmax(inner)), inner.shape)
    x, y = (float(v) for v in dem.geometry.to_map(row + height // 4 + 0.3, col + width // 4 + 0.4))
    x_min, y_min, x_max, y_max = dem.geometry.bounds
    corner_x = x_min if x - x_min > x_max - x else x_max
    corner_y = y_min if y - y_min > y_max - y else y_max
    azimuth = math.degrees(math.atan2(corner_x - x, corner_y - y))
    return Pose.from_angles((x, y, float(dem.elevation_at(x, y)) + _MAST_M), azimuth, -5.0, 2.0)


def run(
    sizes: list[int], scenes: list[Scene], repeats: int, tracers: tuple[str, ...] = TRACERS
) -> Iterator[TracerCost | Skipped]:
    """Measure one tracer after the other and yield each result when it is ready."""
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as folder:
        for size in sizes:
            raster = Path(folder) / f"{size}.npy"
            np.save(raster, ridged_terrain(size).elevation)
            for name in tracers:
                peer = next((kind for kind in PEERS if kind.name == name), None)
                if peer is not None and (reason := _reason_to_skip(peer, size)):
                    yield Skipped(name, size, reason)
                    continue
                try:
                    yield in_own_process(measure, name, raster, scenes, repeats)
                except Exception as error:  # whatever a peer raises, or a process that ran out of memory
                    yield Skipped(name, size, f"{type(error).__name__}: {error}".splitlines()[0])
            raster.unlink()


def _reason_to_skip(kind: PeerKind, size: int) -> str | None:
    if not kind.installed:
        return "not installed"
    needs, free = kind.bytes_per_cell * size * size / 1e6, available_mb()
    if free is not None and needs > free:
        return f"needs about {needs / 1e3:.0f} GB of memory, {free / 1e3:.0f} GB are free"
    return None


def measure(name: str, raster: Path, scenes: list[Scene], repeats: int) -> TracerCost:
    """Return the cost of tracer `name` on the heights in `raster`. Call it in a fresh process: it reads the peak."""
    elevation = np.load(raster)
    size = elevation.shape[0]
    dem = Dem(elevation, GridGeometry(0.0, float(size), 1.0, size, size))
    pose = bench_pose(dem)
    small = Dem(np.ascontiguousarray(elevation[:40, :40]), GridGeometry(0.0, 40.0, 1.0, 40, 40))
    kind = next((k for k in PEERS if k.name == name), None)
    make: Callable[[Dem], Any] = TerrainTracer if kind is None else kind.make
    make(small)  # imports and compiles
    before = resident_mb()
    made: list[Any] = []
    setup = cost_of(lambda: made.append(make(dem)))
    frames = {}
    steps = itertools.count(1)
    for scene in scenes:
        if kind is None:
            frames[scene.name] = _ours(made[0], scene, pose, repeats, steps)
        else:
            call = made[0].prepare(TracedView(scene.camera(kind.every), pose))
            if kind.every == 1:
                call()
            frames[scene.name] = {"": least_cost(call, repeats).scaled(kind.every**2)}
    return TracerCost(name, size, setup, peak_mb() - before, frames)


def _ours(tracer: TerrainTracer, scene: Scene, pose: Pose, repeats: int, steps: Iterator[int]) -> dict[str, Cost]:
    """Return our cost by state. `steps` yields new numbers, so that no position and no direction comes twice."""
    camera = scene.camera()
    tracer.trace(camera, pose)

    def moved(k: int) -> Pose:
        return replace(pose, position=pose.position + np.array([0.01 * (k + 1), 0.0, 0.0]))

    def turned(k: int) -> Pose:
        azimuth, pitch, roll = pose.angles_deg
        return Pose.from_angles(pose.position, azimuth + 0.01 * (k + 1), pitch, roll)

    cold = least_cost(lambda: tracer.trace(camera, moved(next(steps))), repeats)
    tracer.trace(camera, pose)
    warm = least_cost(lambda: tracer.trace(camera, turned(next(steps))), repeats)
    tracer.trace(camera, pose)
    still = least_cost(lambda: tracer.trace(camera, pose), repeats)
    return {"warm": warm, "cold": cold, "still": still}


@dataclass(frozen=True)
class FrameCost:
    """The cost of a frame by one tracer in one state; `over_warm` and `over_cold` compare processor time with ours."""

    size: int
    scene: str
    tracer: str
    state: str
    cost: Cost
    over_warm: float | None
    over_cold: float | None


def frame_costs(results: list[TracerCost]) -> list[FrameCost]:
    """Return the cost of each frame, by scene and size, with the ratios of peers over ours."""
    ours = {result.size: result.frames for result in results if result.tracer == OURS}
    found = []
    for scene in dict.fromkeys(name for result in results for name in result.frames):
        for result in sorted(results, key=lambda result: result.size):
            for state, cost in result.frames[scene].items():
                own = ours.get(result.size, {}).get(scene) if result.tracer != OURS else None
                warm, cold = (None if own is None else cost.cpu_ms / own[one].cpu_ms for one in ("warm", "cold"))
                found.append(FrameCost(result.size, scene, result.tracer, state, cost, warm, cold))
    return found
