"""Process that is a tower of the region's benchmark: `python -m ltm_lab.bench.region_tower ORDER FIRST`.

It offers the frames from FIRST on to the outbox as quickly as that keeps them, and says five times a second how many
are kept and how many wait, until its stdin closes.
"""

from __future__ import annotations

import json
import select
import sys
import time
from pathlib import Path
from typing import Final

from ltm_core.base.strict_model import StrictModel
from ltm_core.uplink.config import UplinkConfig
from ltm_core.uplink.envelope import VotesGrid
from ltm_core.uplink.outbox_io import OutboxFrame
from ltm_lab.bench.network_towers import stamped
from ltm_ros.region.tower_link import TowerLink
from ltm_ros.runtime.health import Health

CAMERA: Final = "mast"
AHEAD: Final = 64
"""Frames that are offered and not yet kept, at most."""
SAY_EVERY_S: Final = 0.2


class TowerOrder(StrictModel):
    """What a tower does: frame k is of `begin_ns` + k `period_ns`, and shows what the k-th of its messages shows."""

    config: UplinkConfig
    grid: VotesGrid
    messages: list[Path]
    frames: int
    begin_ns: int
    period_ns: int
    folder: Path

    def frame(self, number: int, pool: list[bytes]) -> OutboxFrame:
        stamp, view = self.begin_ns + number * self.period_ns, number % len(pool)
        return OutboxFrame(CAMERA, stamp, view, "", stamped(pool[view], stamp))


def main() -> None:
    order = TowerOrder.model_validate_json(Path(sys.argv[1]).read_text(encoding="utf-8"))
    first = int(sys.argv[2])
    pool = [path.read_bytes() for path in order.messages]
    health = Health()
    link = TowerLink(order.config, order.grid, order.folder / "outbox.sqlite", health, time.time_ns)
    link.start()
    offered, said_at = first, 0.0
    while not select.select([sys.stdin], [], [], 0.02 if offered < order.frames else SAY_EVERY_S)[0]:
        while offered < order.frames and offered - first - link.kept < AHEAD:
            link.offer(order.frame(offered, pool))
            offered += 1
        if time.monotonic() - said_at > SAY_EVERY_S:
            said_at = time.monotonic()
            # First what is kept: what waits then has all of it.
            kept = first + link.kept
            summary = health.summary()
            said = {"kept": kept, "waiting": int(summary.get("outbox_frames", -1)), "dropped": health.dropped}
            print(json.dumps(said), flush=True)
    link.stop()


if __name__ == "__main__":
    main()
