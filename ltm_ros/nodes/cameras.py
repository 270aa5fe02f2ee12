"""cameras: run the nodes of all cameras of a site in one process; `python -m ltm_ros.nodes.cameras NODES.json`."""

from __future__ import annotations

import sys
from pathlib import Path

from ltm_ros.launching.graph import CAMERAS_PROCESS, nodes_of_json
from ltm_ros.launching.site_process import SiteProcess
from ltm_ros.runtime.node_process import run_until_stopped


def main() -> None:
    """Run the nodes that the file lists (`nodes_json`), ignoring ROS's own arguments."""
    specs = nodes_of_json(Path(sys.argv[1]).read_text(encoding="utf-8"))
    run_until_stopped(CAMERAS_PROCESS, lambda: SiteProcess(specs))


if __name__ == "__main__":
    main()
