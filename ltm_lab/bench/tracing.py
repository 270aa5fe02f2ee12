"""`ltm-lab bench trace`: times our tracer and its peers on the same views of the same mountains, one process for each.

Ours is timed in three states: *cold*, from a position where no camera stood before; *warm*, another view from the
same position; and *still*, the same camera and pose again.
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_lab.bench.measure import Cost, available_mb, cost_of, least_cost, peak_mb, resident_mb
from ltm_lab.bench.mountains import ridged_terrain
from ltm_lab.bench.peers import PEERS, PeerKind, TracedView

OURS = "ours"
_MAST = 10.0  # metres


@dataclass(frozen=True)
class Scene:
    """An image size and a field of view."""

    name: str
    width: int
    height: int
    hfov_deg: float

    def camera(self, every: int = 1) -> Camera:
        """A lens with some distortion; of every `every`-th pixel."""
        camera = replace(
            Camera.from_fov(self.width, self.height, self.hfov_deg), distortion=(-0.06, 0.01, 0.0, 0.0, 0.0)
        )
        return camera.scaled(every)


SCENES = tuple(
    Scene(f"{size} {fov} deg", width, height, float(fov))
    for size, width, height in (("1080p", 1920, 1080), ("VGA", 640, 480))
    for fov in (60, 5)
)


@dataclass(frozen=True)
class Measured:
    """One tracer on one DEM: costs by scene (and, for ours, state), set-up, memory beyond the DEM at its peak."""

    tracer: str
    size: int
    setup: Cost
    memory_mb: float
    frames: dict[str, dict[str, Cost]]


@dataclass(frozen=True)
class Skipped:
    """A tracer that was not run, and why."""

    tracer: str
    size: int
    reason: str


def bench_pose(dem: Dem) -> Pose:
    """On the highest summit of the raster's inner half, 10 m above the ground, towards the farthest corner."""
    height, width = dem.elevation.shape
    inner = dem.elevation[height // 4 : height - height // 4, width // 4 : width - width // 4]
    row, col = np.unravel_index(int(np.argmax(inner)), inner.shape)
    x, y = (float(v) for v in dem.geometry.to_map(row + height // 4 + 0.3, col + width // 4 + 0.4))
    x_min, y_min, x_max, y_max = dem.geometry.bounds
    corner_x = x_min if x - x_min > x_max - x else x_max
    corner_y = y_min if y - y_min > y_max - y else y_max
    azimuth = math.degrees(math.atan2(corner_x - x, corner_y - y))
    return Pose.from_angles((x, y, float(dem.elevation_at(x, y)) + _MAST), azimuth, -5.0, 2.0)


def run(
    sizes: list[int], scenes: list[Scene], repeats: int, only: set[str] | None = None
) -> Iterator[Measured | Skipped]:
    """Measure everything, one tracer after the other; yields each result as soon as it is there.

    Closing the iterator (or Ctrl-C) ends the measuring process.
    """
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as folder:
        for size in sizes:
            raster = Path(folder) / f"{size}.npy"
            np.save(raster, ridged_terrain(size).elevation)
            for kind in (None, *PEERS):
                name = OURS if kind is None else kind.name
                if only is not None and name not in only:
                    continue
                reason = None if kind is None else _reason_to_skip(kind, size)
                yield Skipped(name, size, reason) if reason else _in_own_process(name, size, raster, scenes, repeats)
            raster.unlink()


def _reason_to_skip(kind: PeerKind, size: int) -> str | None:
    if not kind.installed:
        return "not installed"
    needs, free = kind.bytes_per_cell * size * size / 1e6, available_mb()
    if free is not None and needs > free:
        return f"needs about {needs / 1e3:.0f} GB of memory, {free / 1e3:.0f} GB are free"
    return None


def _in_own_process(name: str, size: int, raster: Path, scenes: list[Scene], repeats: int) -> Measured | Skipped:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_measure_in_child, args=(there, name, raster, scenes, repeats), daemon=True)
    process.start()
    there.close()
    try:
        answer: Measured | str = here.recv()
    except EOFError:
        answer = "its process died (out of memory?)"
    finally:
        process.terminate()
        process.join()
    return Skipped(name, size, answer) if isinstance(answer, str) else answer


def _measure_in_child(connection: Connection, name: str, raster: Path, scenes: list[Scene], repeats: int) -> None:
    try:
        connection.send(measure(name, np.load(raster), scenes, repeats))
    except KeyboardInterrupt:
        pass
    except Exception as error:
        connection.send(f"{type(error).__name__}: {error}".splitlines()[0])


def measure(name: str, elevation: np.ndarray[Any, np.dtype[np.float32]], scenes: list[Scene], repeats: int) -> Measured:
    """Cost of tracer `name` in this process; call it in a fresh one, or its memory is not its own."""
    from ltm_core.geometry.grid import GridGeometry

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
    return Measured(name, size, setup, peak_mb() - before, frames)


def _ours(tracer: TerrainTracer, scene: Scene, pose: Pose, repeats: int, steps: Iterator[int]) -> dict[str, Cost]:
    """`steps`: numbers that no scene has had before, so that no position and no direction comes again."""
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
