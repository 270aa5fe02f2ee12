"""`ltm run` with all that it writes on a small disk: `unshare -m python full_disk_process.py CASE MOUNT_POINT SITE`."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from bystander import Bystander
from scenes.own_disk import answer, fill, make_disk
from scenes.small_site import NAME, SmallSite
from scenes.waiting import wait_for
from tower_frames import TOPICS, send_frame

from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.storage.tile_store import TileStore
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, IMAGE_COMPRESSED, camera_topic, site_topic

LTM = "from ltm_ros.cli.main import app; app()"
FUEL_MAP, RECORDER = f"/{NAME}/fuel_map", f"/{NAME}/recorder"


def stopped_while_full(disk: Path, site_path: Path) -> dict[str, Any]:
    make_disk(disk, "320m")  # with less than 200 MB free nothing is started
    site, update = SmallSite(site_path.parent), site_topic(NAME, FUEL_MAP_UPDATE)
    command = [sys.executable, "-c", LTM, "run", str(site_path), "--only", "tower", "--record", str(disk / "bag")]
    command += ["--state", str(disk / "state")]
    with Bystander() as bystander:
        graph = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert graph.stdout is not None
        lines: list[str] = []
        try:
            bystander.wait_for_wiring(6)
            bystander.listen(update, FUEL_MAP_UPDATE.type, depth=200)
            for topic in TOPICS:
                bystander.open(camera_topic(NAME, "tower", topic), topic.type, listeners=2)
            bystander.wait_for_wiring(6)
            for _ in range(3):
                bystander.wait_for_stamp(update, send_frame(bystander, site))
            wait_for(lambda: bystander.count(RECORDER, "frames_out") >= 3, "the recorder", lambda: bystander.summaries)
            fill(disk)
            for _ in range(4):
                bystander.wait_for_stamp(update, send_frame(bystander, site))
            wait_for(
                lambda: bystander.count(RECORDER, "dropped.disk_low") > 0, "the floor", lambda: bystander.summaries
            )
            counted = bystander.count(RECORDER, "frames_out")
            dropped = bystander.count(RECORDER, "dropped.disk_low")
            told = len(set(bystander.stamps(update)))
            graph.send_signal(signal.SIGTERM)
            output, _ = graph.communicate(timeout=60)
            lines = output.splitlines()
        finally:
            graph.kill()
            graph.communicate()
    with TileStore.open_read_only(disk / "state" / STORE_FILE, STORE_KIND) as store:
        stored = store.frame_count()
    images = BagReader(disk / "bag").topic_infos()[camera_topic(NAME, "tower", IMAGE_COMPRESSED)].message_count
    return {
        "status": graph.returncode,
        "console": lines,
        "restarts": [line for line in lines if re.search(r"restarting in", line)],
        "lost": [line for line in lines if "frames are lost" in line],
        "counted": counted,
        "recorded": images,
        "dropped": dropped,
        "stored": stored,
        "told": told,
    }


if __name__ == "__main__":
    answer({"stopped_while_full": stopped_while_full})
