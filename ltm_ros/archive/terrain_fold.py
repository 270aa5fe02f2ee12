"""A site's terrain map of an archive: measured frames in the order of their stamps, decided on after each, as a replay
does; and at the end of each day what it tells the fuel map.

The terrain map hangs on the order of frames, so this is done in one place, from the files that tasks have measured.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import BinaryIO

from ltm_core.confirmed_terrain import terrain_grid
from ltm_core.errors import LtmError, StoreError
from ltm_core.frame_at_work import MeasuredFrame
from ltm_core.fuel.surface_change import SOURCE, LivingFuelMap
from ltm_core.fuel.surface_news import SurfaceMoves, take_news
from ltm_core.raster.tile_store import CellChanges, FrameRecord, TileStore
from ltm_core.site import Site
from ltm_core.terrain.site_terrain import UNCOMMITTED, SiteTerrain
from ltm_ros.archive.frame_files import LostFrame, lost_of_measured, read_measured
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import Task
from ltm_ros.runtime.health import cause_of

OpenMeasured = Callable[[Task], AbstractContextManager[BinaryIO]]
"""Opens the file of a task's measured frames."""


class TerrainFold:
    """Writes the terrain's store into `path`, where nothing must be yet.

    Raises ConfigError for a site without a terrain, StoreError where the store cannot be written.
    """

    def __init__(self, site: Site, path: Path, open_measured: OpenMeasured) -> None:
        self._terrain = SiteTerrain(site, lambda schema: TileStore.open(path, schema))
        assert site.terrain is not None  # nosec B101 # tells the type checker what holds
        self._moves = SurfaceMoves(terrain_grid(site.open_dem().geometry, site.terrain.resolution))
        self._open = open_measured
        self.frames = 0
        """Taken in."""
        self.lost: list[LostFrame] = []
        """Of which nothing was measured, or what was measured could not be taken in."""

    def take_day(self, tasks: Sequence[Task]) -> None:
        """The frames of a day's tasks. Raises StoreError; ArchiveError, OSError where a file cannot be read now."""
        surface = self._terrain.map
        for frame, measured in measured_frames(tasks, self._open, self.lost):
            self._take(frame, measured)
            self._moves.take(surface.decide())
            if surface.uncommitted >= UNCOMMITTED:
                surface.commit()

    def tell(self, evidence: LivingFuelMap) -> tuple[list[FrameRecord], list[CellChanges]]:
        """Have a fuel map know what has changed by now: what belongs into its store."""
        surface = self._terrain.map
        window = surface.seen_window()
        if window is None:
            return [], []
        news = self._moves.news(surface.layers(window).told, window, evidence)
        if not len(news):
            return [], []
        taken = take_news(evidence, news, surface.newest_ns)
        for key, tile in taken.tiles.items():
            evidence.load_tile(key, tile)
        return [FrameRecord(SOURCE, surface.newest_ns, sorted(taken.tiles))], [taken.change]

    def close(self) -> None:
        """Write all. Raises StoreError."""
        self._terrain.map.commit(last=True)
        self._terrain.map.close()

    def _take(self, frame: ArchiveFrame, measured: MeasuredFrame) -> None:
        try:
            self._terrain.add(
                measured.depth,
                measured.sigma,
                frame.calibration,
                frame.pose,
                frame.stamp_ns,
                frame.camera,
                frame.known_covariance,
                measured.labels,
            )
        except StoreError:
            raise
        except LtmError as error:
            why = f"terrain: {error} ({frame.file}, stamp {frame.stamp_ns} ns)"
            self.lost.append(LostFrame(frame.camera, frame.stamp_ns, cause_of(error), why))
        else:
            self.frames += 1


def measured_frames(
    tasks: Sequence[Task], open_measured: OpenMeasured, lost: list[LostFrame]
) -> Iterator[tuple[ArchiveFrame, MeasuredFrame]]:
    """What tasks, each camera's in their order, have measured, in the order of stamps; of equal ones, as they were
    logged, as a replay takes them. `lost` gets the frames of which nothing was. Of each camera one file is open at a
    time, and one frame held."""
    of_cameras: dict[str, list[Task]] = {}
    for task in tasks:
        of_cameras.setdefault(task.frames[0].camera, []).append(task)
    streams = [_of_camera(its, open_measured, lost) for its in of_cameras.values()]
    yield from heapq.merge(*streams, key=lambda found: (found[0].stamp_ns, found[0].log_time_ns, found[0].camera))


def _of_camera(
    tasks: Sequence[Task], open_measured: OpenMeasured, lost: list[LostFrame]
) -> Iterator[tuple[ArchiveFrame, MeasuredFrame]]:
    for task in tasks:
        frames = {frame.stamp_ns: frame for frame in task.frames}
        with open_measured(task) as file:
            lost += lost_of_measured(file)
            for stamp, measured in read_measured(file):
                yield frames[stamp], measured
