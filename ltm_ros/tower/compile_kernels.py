"""Compiles the kernels that a site's nodes need, before they run: `python -m ltm_ros.tower.compile_kernels SITE`.

A new release does this while the former one still works, so that the tower stands still for seconds, not minutes.
"""

from __future__ import annotations

import sys
import tempfile
import time

from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import describe
from ltm_ros.recordings.replay.offline import OfflineGraph

KEEPING_NODES = ("fuel_map", "terrain")


def main() -> None:
    begun = time.monotonic()
    # Every handler as a node makes it, but on empty stores: the tower's own are another process's.
    with tempfile.TemporaryDirectory() as folder:
        kept = {kind: {"folder": folder} for kind in KEEPING_NODES}
        # Without sources: a camera may refuse a second one that asks, and an upgrade needs no picture.
        graph = describe(load_site(sys.argv[1]), sys.argv[1], parameters=kept, sources=False)
        OfflineGraph(graph).finish()
    print(f"kernels of {len(graph)} nodes are compiled: {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
