from __future__ import annotations

from pathlib import Path

import yaml
from scenes.phone_site import LAT, LON, STAMP, phone_site, picture
from sensor_msgs.msg import Imu, NavSatFix

from ltm_core.geometry.camera import Camera
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header
from ltm_ros.recordings.replay.offline import Selection


def test_a_phones_fixes_and_attitudes_are_played(tmp_path: Path) -> None:
    phone_site(tmp_path)
    document = yaml.safe_load((tmp_path / "site.yaml").read_text())
    document["cameras"] = {"phone": {"sensors": {}}}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(document))
    fix = NavSatFix(header=make_header(STAMP, "gps"), latitude=LAT, longitude=LON, altitude=1470.0)
    turn = Imu(header=make_header(STAMP, "phone"))
    turn.orientation.w = 1.0
    messages = {
        "camera_info": camera_to_msg(Camera(64, 40, 48.0, 48.0, 31.5, 19.5), STAMP, "phone"),
        "fix": fix,
        "imu": turn,
        "image_raw/compressed": compressed_to_msg(encode_rgb(picture(), "jpeg"), "jpeg", STAMP, "phone"),
    }
    with BagWriter(tmp_path / "bag") as bag:
        for name, message in messages.items():
            bag.write(f"/ridge/phone/{name}", message, STAMP)
    selection = Selection.open(tmp_path / "bag", load_site(tmp_path / "site.yaml"))
    played = {message.topic.rsplit("phone/", 1)[1]: selection.reader.decode(message) for message in selection}
    assert played.keys() == messages.keys()
    assert (played["fix"].latitude, played["fix"].longitude) == (LAT, LON)
    assert played["imu"].orientation.w == 1.0
