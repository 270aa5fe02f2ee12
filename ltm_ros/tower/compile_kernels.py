"""Compile the kernels that a site's nodes need before they run: `python -m ltm_ros.tower.compile_kernels SITE`.

An upgrade does this while the previous release still runs, so that the tower stops for seconds instead of minutes.
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
    # Every handler as a node makes it, but on empty stores: the tower's own are in use.
    with tempfile.TemporaryDirectory() as folder:
        kept = {kind: {"folder": folder} for kind in KEEPING_NODES}
        # Without sources: a camera may reject a second client, and an upgrade needs no image.
        graph = describe(load_site(sys.argv[1]), sys.argv[1], parameters=kept, sources=False)
        OfflineGraph(graph).finish()
    print(f"compiled the kernels of {len(graph)} nodes in {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
