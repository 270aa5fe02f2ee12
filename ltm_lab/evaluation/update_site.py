"""A site on disk of an exact hillside scene, and what its two towers measure there, as messages of a graph."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_core.surface.observation import DepthFrame
from ltm_lab.evaluation.terrain.hillside_ground import TOWERS
from ltm_lab.evaluation.terrain.hillside_scenes import HillsideScene, SceneConditions, frames
from ltm_msgs_py.camera_info import camera_to_msg
from ltm_msgs_py.image import depth_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import MEASURED_DEPTH, MEASURED_SIGMA, POSED_CAMERA_INFO, POSED_POSE

NAME = "hillside"
ORIGIN = (480_000.0, 4_150_000.0)
_CRS = "EPSG:26911"
_LONG_AGO = 1e10
"""Seconds: frames of a scene are not of today."""
PARTS = (POSED_CAMERA_INFO, POSED_POSE, MEASURED_SIGMA, MEASURED_DEPTH)


@dataclass(frozen=True, eq=False)
class UpdateSite:
    """`path`: of the site file. `frames`: what the towers measure of the surface as it is now, in order."""

    path: Path
    scene: HillsideScene
    frames: tuple[DepthFrame, ...]
    graph: Graph

    @property
    def surfaces(self) -> Path:
        """Where versions of the confirmed surface are kept."""
        return self.path.parent / "kept" / "surfaces"


def write_update_site(folder: Path, scene: HillsideScene, looks: int, seed: int, processes: str) -> UpdateSite:
    """Site file and rasters into an empty folder; of its graph the nodes that make and follow the confirmed surface.

    `processes`: layout, `site` or `node`.
    """
    conditions = SceneConditions(looks=looks, seed=seed)
    for name, dem in (("dem", scene.bare), ("surface", scene.given)):
        geometry = dem.geometry.translated(*ORIGIN, crs=_CRS)
        Dem(dem.elevation, geometry).save(folder / f"{name}.tif")
    content = {
        "name": NAME,
        "crs": _CRS,
        "origin": list(ORIGIN),
        "dem": {"path": "dem.tif"},
        "surface": {"path": "surface.tif"},
        "processes": processes,
        # Errors of these depths are new in most looks, and normal: see `hillside_scenes.Noise`.
        "terrain": {"trace_confirmed": True, "repeated_error_share": conditions.noise.repeats, "alone": 3.0},
        "nodes": {"terrain": {"folder": "kept", "depth_from_elsewhere": True, "max_behind": _LONG_AGO}},
        "cameras": {name: {} for name in TOWERS},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    whole = describe(load_site(path), path)
    nodes = tuple(node for node in whole if node.name in ("terrain", "depth"))
    return UpdateSite(path, scene, tuple(frames(scene, conditions)), Graph(NAME, nodes))


def messages_of(frame: DepthFrame) -> Iterator[tuple[Topic, Any]]:
    """What a capture and a range finder would send of it, by topic of its camera."""
    stamp, optical = frame.stamp_ns, f"{frame.source}_optical"
    yield POSED_CAMERA_INFO, camera_to_msg(frame.camera, stamp, optical)
    yield POSED_POSE, pose_to_msg(frame.pose, stamp, covariance=frame.covariance)
    yield MEASURED_SIGMA, depth_to_msg(frame.sigma, stamp, optical)
    yield MEASURED_DEPTH, depth_to_msg(frame.depth, stamp, optical)
