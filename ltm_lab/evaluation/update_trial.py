"""Test whether traced depth follows the surface that the terrain confirms, in an exact hillside scene.

A scene is written as a site, the messages of its two towers are fed to the graph's own handlers, and the traced depth
before and after the confirmation is scored and drawn."""

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from ltm_core.base.types import BoolArray, Float32Array, Int32Array
from ltm_core.pictures.legend import RangeScale
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_core.surface.observation import DepthFrame
from ltm_core.tracing import TerrainTracer
from ltm_lab.evaluation.pictures.depth_sheet import depth_bar, error_bar, frame_figure, show_depth, show_error
from ltm_lab.evaluation.terrain.hillside_ground import TOWERS
from ltm_lab.evaluation.terrain.hillside_scenes import HillsideScene, SceneConditions, frames
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.cells import msg_to_version
from ltm_msgs_py.image import depth_to_msg, msg_to_depth
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    DEPTH_INFO,
    MEASURED_DEPTH,
    MEASURED_SIGMA,
    POSED_CAMERA_INFO,
    POSED_POSE,
    TERRAIN_SURFACE,
    camera_topic,
    site_topic,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "hillside"
SURFACE = site_topic(NAME, TERRAIN_SURFACE)
_ORIGIN = (480_000.0, 4_150_000.0)
_CRS = "EPSG:26911"
_MAX_BEHIND_S = 1e10
"""The frames of a scene are years old."""
_CHANGED_M = 1.5
"""Change of a cell's true surface that counts, metres: the map's own threshold."""

Depths = dict[tuple[str, int], tuple[str, Float32Array]]
"""By camera and stamp: the version of the surface that was traced, and the depth (H, W)."""


@dataclass(frozen=True, eq=False)
class UpdateSite:
    """A site file, the frames of its towers in order, and the nodes that make and follow the confirmed surface."""

    path: Path
    scene: HillsideScene
    frames: tuple[DepthFrame, ...]
    graph: Graph


def write_update_site(folder: Path, scene: HillsideScene, looks: int, seed: int, processes: str = "site") -> UpdateSite:
    """Write the site file and rasters of a scene into an empty folder; `processes` is the layout, `site` or `node`."""
    conditions = SceneConditions(looks=looks, seed=seed)
    for name, dem in (("dem", scene.bare), ("surface", scene.given)):
        Dem(dem.elevation, dem.geometry.translated(*_ORIGIN, crs=_CRS)).save(folder / f"{name}.tif")
    tuning = {"repeated_error_share": conditions.noise.repeats, "alone": 3.0}
    content = {
        "name": NAME,
        "crs": _CRS,
        "origin": list(_ORIGIN),
        "dem": {"path": "dem.tif"},
        "surface": {"path": "surface.tif"},
        # The noise is normal, and mostly new in each frame: see `hillside_scenes.Noise`.
        "terrain": {"trace_confirmed": True},
        "expert": {"processes": processes, "terrain": tuning},
        "nodes": {"terrain": {"folder": "kept", "depth_from_elsewhere": True, "max_behind": _MAX_BEHIND_S}},
        "cameras": {name: {} for name in TOWERS},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    nodes = tuple(node for node in describe(load_site(path), path) if node.name in ("terrain", "depth"))
    return UpdateSite(path, scene, tuple(frames(scene, conditions)), Graph(NAME, nodes))


def messages_of(frame: DepthFrame) -> Iterator[tuple[Topic, Any]]:
    """Yield the messages that a capture node and a range finder send of a frame, by topic of its camera."""
    stamp, optical = frame.stamp_ns, f"{frame.source}_optical"
    yield POSED_CAMERA_INFO, camera_to_msg(frame.camera, stamp, optical)
    yield POSED_POSE, pose_to_msg(frame.pose, stamp, covariance=frame.covariance)
    yield MEASURED_SIGMA, depth_to_msg(frame.sigma, stamp, optical)
    yield MEASURED_DEPTH, depth_to_msg(frame.depth, stamp, optical)


class TracedDepths:
    """Collects traced depth and the versions of the surface; `takes` are the callbacks by topic."""

    def __init__(self) -> None:
        self.versions: list[str] = []
        self._depth: dict[tuple[str, int], Float32Array] = {}
        self._traced: dict[tuple[str, int], str] = {}
        self.takes: dict[str, Callable[[Any], None]] = {SURFACE: lambda m: self.versions.append(msg_to_version(m))}
        for camera in TOWERS:
            self.takes[camera_topic(NAME, camera, DEPTH_IMAGE)] = partial(self._on_depth, camera)
            self.takes[camera_topic(NAME, camera, DEPTH_INFO)] = partial(self._on_info, camera)

    def depths(self) -> Depths:
        """Return the depth of the frames that are complete."""
        return {key: (self._traced[key], depth) for key, depth in self._depth.items() if key in self._traced}

    def _on_depth(self, camera: str, message: Any) -> None:
        self._depth[camera, stamp_of(message)] = msg_to_depth(message)

    def _on_info(self, camera: str, message: Any) -> None:
        self._traced[camera, stamp_of(message)] = msg_to_version(message)


def offline_depths(site: UpdateSite) -> tuple[Depths, str]:
    """Return the traced depth of the site's frames, and a digest of depth and versions that is the same in each run."""
    found = TracedDepths()
    with tempfile.TemporaryDirectory(prefix="ltm-update-") as name:
        bag = Path(name) / "bag"
        writer = BagWriter(bag)
        graph = OfflineGraph(site.graph, writer)
        for frame in site.frames:
            for topic, message in messages_of(frame):
                graph.feed(camera_topic(NAME, frame.source, topic), message, frame.stamp_ns)
        graph.finish()
        writer.close()
        reader = BagReader(bag)
        for recorded in reader.messages(list(found.takes)):
            found.takes[recorded.topic](reader.decode(recorded))
    digest = hashlib.sha256("".join(found.versions).encode())
    for (camera, stamp), (version, depth) in sorted(found.depths().items()):
        digest.update(f"{camera} {stamp} {version}".encode() + np.ascontiguousarray(depth).tobytes())
    return found.depths(), digest.hexdigest()


@dataclass(frozen=True)
class UpdateScore:
    """Median error of traced depth, metres, over the pixels whose cell has changed, as given or in truth.

    `before` is that of the frames before any surface was confirmed, `after` that of the later half of all frames, of
    which `followed` were traced to a confirmed surface."""

    frames_before: int
    frames_after: int
    followed: int
    before: float
    after: float

    @property
    def ratio(self) -> float:
        """The error after the confirmation over that before."""
        return self.after / self.before


def score_update(
    scene: HillsideScene, frames: Sequence[DepthFrame], depths: Mapping[tuple[str, int], tuple[str, Float32Array]]
) -> UpdateScore:
    """Score the traced depth of a scene; frames without depth, as of a killed process, are left out."""
    moved = np.abs(scene.true_now.elevation - scene.given.elevation) >= _CHANGED_M
    given, true = (TerrainTracer(dem) for dem in (scene.given, scene.true_now))
    before: list[Float32Array] = []
    after: list[Float32Array] = []
    followed = 0
    for number, frame in enumerate(frames):
        version, depth = depths.get((frame.source, frame.stamp_ns), ("", None))
        later = number >= len(frames) // 2
        if depth is None or (version and not later):
            continue
        was, now = (tracer.trace(frame.camera, frame.pose) for tracer in (given, true))
        truth = now.depth()
        known = np.isfinite(truth) & np.isfinite(depth) & (_on(moved, was.cells()) | _on(moved, now.cells()))
        (after if later else before).append(np.abs(depth[known] - truth[known]))
        followed += later and bool(version)
    medians = (float(np.median(np.concatenate(errors))) if errors else float("nan") for errors in (before, after))
    return UpdateScore(len(before), len(after), followed, *medians)


def update_figure(
    scene: HillsideScene, frames: Sequence[DepthFrame], depths: Mapping[tuple[str, int], tuple[str, Float32Array]]
) -> "Figure":
    """Draw the true depth of the first camera's last frame, and the errors of its depth as given and as traced."""
    frame = next(one for one in reversed(frames) if one.source == frames[0].source)
    true, given = (TerrainTracer(dem).trace(frame.camera, frame.pose).depth() for dem in (scene.true_now, scene.given))
    version, traced = depths[frame.source, frame.stamp_ns]
    figure, rows = frame_figure(1, true.shape)
    scale = RangeScale.of(true)
    show_depth(rows[0][0], true, scale, f"{scene.name}, a synthetic scene: true depth")
    show_error(rows[0][1], given, true, "error of depth traced to the terrain as given")
    show_error(rows[0][2], traced, true, f"error of depth traced to surface {version or 'as given'}")
    depth_bar(figure, rows[0][:1], scale)
    error_bar(figure, rows[0][1:])
    return figure


def _on(cells: BoolArray, places: Int32Array) -> BoolArray:
    """Return whether the (row, col) of each pixel, (H, W, 2), is one of `cells`; (H, W)."""
    rows, cols = places[..., 0], places[..., 1]
    inside = (rows >= 0) & (cols >= 0) & (rows < cells.shape[0]) & (cols < cells.shape[1])
    return np.asarray(inside & cells[np.where(inside, rows, 0), np.where(inside, cols, 0)], np.bool_)
