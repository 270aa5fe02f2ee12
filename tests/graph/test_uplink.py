import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from bystander import Bystander
from scenes.free_port import free_port
from scenes.mqtt_broker import Broker
from scenes.small_site import NAME, SmallSite
from scenes.waiting import wait_for
from tower_frames import TOPICS, send_frame

from ltm_core.base.resources import config_path
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_ros.region.certs import TrialAuthority
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, camera_topic, site_topic

pytestmark = pytest.mark.graph
LTM = "from ltm_ros.cli.main import app; app()"
FRAMES = 3


def stored(site: Path, store: Path) -> tuple[EvidenceMap, dict[str, int]]:
    """A fuel map in its store, and the frames in it by camera."""
    loaded = load_site(site)
    grid = loaded.fuel_geometry(loaded.open_dem())
    empty = site_evidence_map(loaded, grid, LabelSet.load(config_path(loaded.labels)))
    if not store.exists():
        return empty, {}
    with open_stored_map(store, loaded, empty) as opened:
        return empty, opened.sources()


@contextmanager
def running(console: Path, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    with console.open("w") as output:
        process = subprocess.Popen([sys.executable, "-c", LTM, *arguments], stdout=output, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def write_files(small: SmallSite, folder: Path, port: int) -> tuple[Path, Path, Path]:
    """The site of the tower `peak`, that of its region, and region.yaml."""
    TrialAuthority(folder / "certs", days=2).make("kern", ["peak"], ["127.0.0.1"], "127.0.0.1", port)

    def broker(name: str) -> dict[str, str | int]:
        files = {"ca": "ca.crt", "certificate": f"{name}.crt", "key": f"{name}.key"}
        return {"host": "127.0.0.1", "port": port, **{k: str(folder / "certs" / file) for k, file in files.items()}}

    keys = yaml.safe_load(small.path.read_text())
    tower, map_, region = small.folder / "peak.yaml", small.folder / "kern.yaml", folder / "region.yaml"
    section = {"name": "kern", "tower": "peak", "broker": broker("peak")}
    tower.write_text(yaml.safe_dump(keys | {"region": section}))
    map_.write_text(yaml.safe_dump(keys | {"name": "kern_map", "cameras": {"peak_tower": {}}}))
    region.write_text(
        yaml.safe_dump(
            {
                "name": "kern",
                "site": str(map_),
                "folder": "map",
                "towers": ["peak"],
                "broker": broker("aggregator"),
                "export": {"folder": "export"},
            }
        )
    )
    return tower, map_, region


@pytest.mark.usefixtures("kernels", "ros_domain")
def test_votes_of_a_running_graph_reach_the_map_of_the_region(small_site: SmallSite, tmp_path: Path) -> None:
    port = free_port()
    tower, map_, region = write_files(small_site, tmp_path, port)
    update, store = site_topic(NAME, FUEL_MAP_UPDATE), tmp_path / "map" / STORE_FILE
    run = ("run", str(tower), "--only", "tower", "--state", str(tmp_path / "state"))
    with running(tmp_path / "console", *run) as graph:
        with Bystander() as bystander:
            bystander.listen(update, FUEL_MAP_UPDATE.type, depth=200)
            for topic in TOPICS:
                bystander.open(camera_topic(NAME, "tower", topic), topic.type, listeners=1)
            bystander.wait_for_wiring(6)  # the camera's four, the map and the uplink
            for _ in range(FRAMES):
                bystander.wait_for_stamp(update, send_frame(bystander, small_site))

            def waits(frames: int) -> bool:
                return bystander.summaries[f"/{NAME}/uplink"].get("outbox_frames") == str(frames)

            wait_for(lambda: waits(FRAMES), "the outbox", lambda: bystander.summaries[f"/{NAME}/uplink"])
            with (
                Broker(tmp_path / "certs/mosquitto.conf", port),
                running(tmp_path / "region", "region", str(region)) as kern,
            ):
                wait_for(lambda: waits(0), "an empty outbox", (tmp_path / "region").read_text, patience_s=120.0)
                kern.send_signal(signal.SIGTERM)
                assert kern.wait(60) == 0, (tmp_path / "region").read_text()
        # The bystander has gone: what it maps of a node that had to be ended (`dds_shutdown`), no runner can remove.
        graph.send_signal(signal.SIGTERM)
        assert graph.wait(60) == 0
    own, of_tower = stored(tower, tmp_path / "state" / STORE_FILE)
    found, of_region = stored(map_, store)
    assert (of_tower, of_region) == ({"tower": FRAMES}, {"peak_tower": FRAMES})
    seen = 0
    for key in own.tiles_of((0, 0, *own.geometry.shape)):
        mine, theirs = own.tile_state(key), found.tile_state(key)
        seen += int((mine["last_seen"] > 0).sum())
        for field in mine.keys() - {"camera_hashes", "seen_by"}:  # which go by the cameras' names
            np.testing.assert_array_equal(mine[field], theirs[field])
    assert seen > 50
    layers = {path.name for path in (tmp_path / "export").glob("*.tif")}
    assert {"code.tif", "life_form.tif", "evidence.tif"} <= layers
    assert (tmp_path / "export/item.stac.json").is_file()
