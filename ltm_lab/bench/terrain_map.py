"""`ltm-lab bench terrain`: processor time a 1080p frame, and memory, of updating a surface map of 4 km x 4 km at 1 m."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface import DepthFrame, LabelImage, Reference, SurfaceMap
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.tile_pool import schema_of
from ltm_core.tracing import TerrainTracer
from ltm_lab.bench.measure import Cost, cost_of, least_cost, peak_mb, resident_mb
from ltm_lab.bench.mountains import ridged_terrain

_NETWORK = 160, 88
"""Columns and rows of the shipped network's depth."""
_HOUR_NS = 3_600_000_000_000


@dataclass(frozen=True)
class SurfaceCost:
    """`still`: a frame of a camera that stands still. `told`: one whose depth has a network's size and whose labels
    have the photo's, over a wood of 4 m on a site of 2000 cells a side. `turned`: of one that has turned since its last
    frame, with its registration and the tracing of the reference. `decide`: where the last frame changed. `memory_mb`:
    of the map after `views` views in all directions, with the reference and its tracer, its store in a file; `peak_mb`:
    of the process, input included. `tiles`: in memory.
    """

    still: Cost
    told: Cost
    turned: Cost
    decide: Cost
    memory_mb: float
    peak_mb: float
    tiles: int
    views: int
    pixels: tuple[int, int]
    cells: tuple[int, int]


class _Tower:
    """On a summit of a ridged terrain; `tall`: a metre higher, which is what a map is given."""

    def __init__(self, size: int, camera: Camera) -> None:
        self.bare = bare = ridged_terrain(size)
        self.tall = Dem(bare.elevation + np.float32(1.0), bare.geometry)
        self._camera, self._tracer, self._rng = camera, TerrainTracer(bare), np.random.default_rng(3)
        middle = size // 2
        part = bare.elevation[middle - 200 : middle + 200, middle - 200 : middle + 200]
        row, col = (int(v) + middle - 200 for v in np.unravel_index(int(np.argmax(part)), part.shape))
        x, y = (float(v) for v in bare.geometry.to_map(row, col))
        self._place = x, y, float(bare.elevation[row, col]) + 12.0

    def frame(self, azimuth: float, look: int) -> DepthFrame:
        """The depth image that the tower sees, minutes after the last look."""
        pose = Pose.from_angles(self._place, azimuth, -12.0, 1.0)
        depth = self._tracer.trace(self._camera, pose).depth()
        sigma = (0.3 + 0.01 * np.where(np.isfinite(depth), depth, 0)).astype(np.float32)
        noisy = depth + sigma * self._rng.standard_normal(depth.shape, np.float32)
        stamp = 1_700_000_000_000_000_000 + look * _HOUR_NS // 60
        return DepthFrame(noisy, sigma, np.ones(depth.shape, np.bool_), self._camera, pose, stamp, "tower")


def _told(camera: Camera, repeats: int, config: TerrainConfig) -> Cost:
    tower = _Tower(2000, camera)
    wood = Dem(tower.bare.elevation + np.float32(4.0), tower.bare.geometry)
    small, rng = camera.resized(*_NETWORK), np.random.default_rng(5)
    surface = SurfaceMap(Reference.of(tower.bare, wood), config, ("tower",), gone=np.ones(256, np.float32))

    def frame(look: int) -> DepthFrame:
        whole = tower.frame(0.0, look)
        depth = cv2.resize(whole.depth, _NETWORK, interpolation=cv2.INTER_NEAREST)
        ids = rng.integers(1, 5, (camera.height // 6, camera.width // 6), np.uint8)
        labels = np.repeat(np.repeat(ids, 6, axis=0), 6, axis=1)
        return replace(
            whole,
            depth=depth,
            sigma=np.float32(0.15) * depth,
            measured=np.isfinite(depth),
            camera=small,
            full_labels=LabelImage(labels, camera),
        )

    surface.add(frame(0))
    waiting = iter([frame(look) for look in range(1, repeats + 1)])
    return least_cost(lambda: surface.add(next(waiting)), repeats)


def measure_surface(
    folder: Path, size: int = 4000, repeats: int = 5, views: int = 12, config: TerrainConfig | None = None
) -> SurfaceCost:
    """A tower on a summit of a ridged terrain that is a metre lower than the surface that was given; sigma 0.3 m + 1 %
    of range, independent by pixel. The map's store is made in `folder`, which must be empty.
    """
    config = config or TerrainConfig()
    camera = Camera.from_fov(1920, 1080, 54.0)
    # Kernels are compiled on a small site: a large map that is gone again would leave holes in the process's memory.
    tiny = _Tower(500, camera)
    first = SurfaceMap(Reference.of(tiny.bare, tiny.tall), config, ("tower",))
    first.add(tiny.frame(0.0, 0)), first.add(tiny.frame(0.0, 1)), first.decide()
    del first, tiny
    tower = _Tower(size, camera)
    bare, frame = tower.bare, tower.frame
    for i in range(views):
        frame(i * 360.0 / views, 0)  # what the tower's own tracer keeps of each pose is not the map's memory
    before = resident_mb()
    reference = Reference.of(bare, tower.tall)
    store = TileStore.open(folder / "terrain.sqlite", schema_of(reference.geometry))
    surface = SurfaceMap(reference, config, ("tower",), store)
    look = 0
    turned: list[Cost] = []
    for i in range(views):
        view = frame(i * 360.0 / views, look := look + 1)
        turned.append(cost_of(lambda view=view: surface.add(view)))  # type: ignore[misc]
        surface.decide()
    memory = resident_mb() - before
    again = [frame((views - 1) * 360.0 / views, look := look + 1) for _ in range(repeats)]
    waiting = iter(again)
    still = least_cost(lambda: surface.add(next(waiting)), repeats)
    decided = cost_of(surface.decide)
    store.close()
    peak = peak_mb()
    return SurfaceCost(
        still,
        _told(camera, repeats, config),
        Cost(float(np.median([c.cpu_ms for c in turned])), float(np.median([c.wall_ms for c in turned]))),
        decided,
        memory + 2 * bare.elevation.nbytes / 1e6,
        peak,
        surface.tiles_in_memory,
        views,
        (camera.width, camera.height),
        bare.geometry.shape,
    )
