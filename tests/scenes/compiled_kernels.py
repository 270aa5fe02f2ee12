"""The nodes' kernels, compiled once for all processes of a test run.

Numba keeps what it has compiled in a folder that all processes share, but two that need a kernel at the same time both
compile it: cold, every node of a graph and every worker would spend a minute or two on the same.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from ltm_ros.nodes.depth import Depth, DepthConfig
from ltm_ros.nodes.fuel_map import FuelMap, FuelMapConfig
from ltm_ros.nodes.fuel_votes import FuelVotes
from ltm_ros.nodes.terrain import Terrain, TerrainNodeConfig
from ltm_ros.nodes.topodepth import TopoDepth, TopoDepthConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.stamp_join import JoinConfig
from scenes.outlets import Kept
from scenes.terrain_frames import write_fusing_site


def _fusion(site: str) -> None:
    TopoDepth(TopoDepthConfig(site=site, camera="mast"), Kept(), Health())


def _terrain(site: str) -> None:
    Terrain(TerrainNodeConfig(site=site), Kept(), Health())


def _fuel(site: str) -> None:
    Depth(DepthConfig(site=site, camera="mast"), Kept(), Health())
    FuelVotes(JoinConfig(site=site, camera="mast"), Kept(), Health()).start()
    FuelMap(FuelMapConfig(site=site), Kept(), Health()).start()


PARTS: dict[str, Callable[[str], None]] = {"terrain": _terrain, "fusion": _fusion, "fuel": _fuel}
"""Each compiled by one process; the largest first."""


def compile_kernels() -> None:
    """Returns once all are compiled, by this process or by others that do the same now."""
    cache = os.environ.get("NUMBA_CACHE_DIR")
    if cache is None or os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return
    folder = Path(cache)
    # First what nobody is at, then wait for what others are at.
    for wait in (0, 1):
        for name, compile_part in PARTS.items():
            with (folder / f"{name}.lock").open("w") as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
                except BlockingIOError:
                    continue
                done = folder / f"{name}.compiled"
                if not done.exists():
                    with tempfile.TemporaryDirectory() as site:
                        compile_part(str(write_fusing_site(Path(site), recording=False).path))
                    done.touch()


if __name__ == "__main__":
    compile_kernels()
