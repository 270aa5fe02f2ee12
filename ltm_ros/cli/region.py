"""`ltm region`: the fuel map of a region, from the votes of many towers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def region(
    config: Annotated[Path, typer.Argument(help="Region file (YAML).")],
) -> None:
    """Keep the fuel map of a region until Ctrl-C or SIGTERM: count the votes of its towers, which come over MQTT, each
    frame once; send tiles as they change; write GeoTIFFs.
    """
    import os

    from ltm_ros.runtime.ros_environment import thread_limits

    # Before NumPy is loaded: its threads would fight over arrays of a thousand cells.
    os.environ.update(thread_limits(busy=False))

    from ltm_core.uplink.config import load_region
    from ltm_ros.region.service import run_region

    run_region(load_region(config))
