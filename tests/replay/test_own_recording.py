import re
from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scenes.transforms import LINK_OPTICAL, transform_to_msg
from typer.testing import CliRunner

from ltm_core.base.resources import project_path
from ltm_core.fuel.class_map import UNSEEN, read_fuel_map
from ltm_core.geometry.pose import Pose
from ltm_core.storage.image_io import read_rgb
from ltm_msgs_py.bag.cdr import TF_TYPE, transforms_to_raw
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.pose import link_transform, msg_to_transform
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.cli.main import cli

OURS, FRAMES = "/demo/tower_north/", 2
MOST_COMMANDS, MOST_WORDS = 6, 600
BASE_MAST = Pose.from_angles((0.3, -0.2, 2.0), 25.0, 3.0)


def write_ride(folder: Path) -> None:
    """SQLite; two images of the demo, map -> base_link 0.1 s before and after each, and a mast on it, static."""
    demo = BagReader(project_path("bags/demo/recording"))
    rows: list[tuple[int, str, str, bytes]] = []
    for name in ("image_raw/compressed", "camera_info"):
        messages = list(demo.messages([OURS + name]))[:FRAMES]
        rows += [(m.log_time_ns, f"/rig/cam/{name}", m.type_name, m.raw) for m in messages]
    for message in list(demo.messages([OURS + "pose"]))[:FRAMES]:
        posed = demo.decode(message)
        link = msg_to_transform(link_transform("x", posed))
        turn = link.rotation @ BASE_MAST.rotation.T
        base = Pose(link.position - turn @ BASE_MAST.position, turn)
        for off in (-(10**8), 10**8):
            raw = transforms_to_raw([transform_to_msg(base, stamp_of(posed) + off, "map", "base_link")])
            rows.append((message.log_time_ns + off, "/tf", TF_TYPE, raw))
    static = [
        transform_to_msg(BASE_MAST, 0, "base_link", "mast"),
        transform_to_msg(LINK_OPTICAL, 0, "mast", "tower_north_optical"),
    ]
    rows.append((min(rows)[0], "/tf_static", TF_TYPE, transforms_to_raw(static)))
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {(t, kind): writer.add_connection(t, kind, typestore=store) for t, kind in {row[1:3] for row in rows}}
        for time, topic, kind, raw in sorted(rows):
            writer.write(topics[topic, kind], time, raw)


def test_the_guide_leads_from_another_recorders_bag_to_a_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    guide = project_path("docs/recordings.md").read_text(encoding="utf-8")
    guide = guide.partition("## Your own recording\n")[2].partition("\n## ")[0]
    assert len(guide.split()) <= MOST_WORDS
    blocks = re.findall(r"```(sh|yaml)\n(.*?)```", guide, re.DOTALL)
    first, cameras = (yaml.safe_load(text) for kind, text in blocks if kind == "yaml")
    commands = [line.split("  #")[0].split() for kind, text in blocks if kind == "sh" for line in text.splitlines()]
    commands = [command for command in commands if command]
    assert 3 <= len(commands) <= MOST_COMMANDS
    monkeypatch.chdir(tmp_path)
    write_ride(tmp_path / "ride")
    (tmp_path / "dem.tif").symlink_to(project_path("bags/demo/dem.tif"))
    Path("site.yaml").write_text(yaml.safe_dump(first))
    for number, (program, *words) in enumerate(commands):
        assert program == "ltm"
        result = CliRunner().invoke(cli, words, env={"COLUMNS": "2000"})
        assert result.exit_code == (1 if number == 0 else 0), result.output
        if number == 0:  # the line to write is that of the guide
            (line,) = re.findall(r"in the site file: cam: (\{topics: \{.*?\}\})", result.output)
            assert yaml.safe_load(line) == cameras["cameras"]["cam"]
            Path("site.yaml").write_text(yaml.safe_dump(first | cameras))
    assert read_rgb(Path("check.png")).ndim == 3
    classes, _ = read_fuel_map(Path("map/fuel_map.tif"))
    assert (classes != UNSEEN).sum() > 200
    assert read_rgb(Path("map/fuel_map.png")).ndim == 3
