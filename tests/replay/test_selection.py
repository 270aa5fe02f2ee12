from pathlib import Path

import pytest
import yaml
from scenes.phone_site import LAT, LON, STAMP, phone_site, picture
from scenes.small_site import BEGIN_NS, FRAMES, NAME, PERIOD_NS, SmallSite
from sensor_msgs.msg import Imu, NavSatFix

from ltm_core.base.errors import RecordingError
from ltm_core.geometry.camera import Camera
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header
from ltm_ros.recordings.replay.offline import Selection
from ltm_ros.runtime.topics import DEPTH_IMAGE, TRUTH_LABELS, camera_topic

MESSAGES = FRAMES * (3 + 1)
PERIOD = PERIOD_NS / 1e9


def test_takes_all_inputs_in_the_order_of_time(small_site: SmallSite) -> None:
    selection = Selection.open(small_site.bag, small_site.site)
    times = [message.log_time_ns for message in selection]
    assert times == sorted(times)
    assert (selection.message_count, selection.frame_count) == (len(times), 2 * FRAMES) == (MESSAGES, 2 * FRAMES)
    assert (selection.begin_ns, selection.end_ns) == (BEGIN_NS, times[-1] + 1)
    assert selection.end_ns - selection.begin_ns == (FRAMES - 1) * PERIOD_NS + 100_000_001


def test_takes_a_span(small_site: SmallSite) -> None:
    selection = Selection.open(small_site.bag, small_site.site, start=PERIOD, duration=2 * PERIOD)
    times = [message.log_time_ns for message in selection]
    assert min(times) == BEGIN_NS + PERIOD_NS
    assert max(times) < BEGIN_NS + 3 * PERIOD_NS == selection.end_ns
    assert (selection.message_count, selection.frame_count) == (8, 4)
    assert Selection.open(small_site.bag, small_site.site, duration=1e6).message_count == MESSAGES


@pytest.mark.parametrize(("start", "duration"), [(60.0, None), (0.0, 0.0), (PERIOD * 0.9, 0.01)])
def test_empty_span_is_an_error_that_says_how_long_the_recording_is(
    small_site: SmallSite, start: float, duration: float | None
) -> None:
    with pytest.raises(RecordingError, match=r"has nothing between .* it is 1\.4 s long"):
        Selection.open(small_site.bag, small_site.site, start, duration)


def test_results_are_never_replayed_and_truth_is(small_site: SmallSite, tmp_path: Path) -> None:
    source = BagReader(small_site.bag)
    raw = next(m for m in source.messages() if m.type_name == "sensor_msgs/msg/Image")
    truth, depth = (camera_topic(NAME, "mast", topic) for topic in (TRUTH_LABELS, DEPTH_IMAGE))
    with BagWriter(tmp_path / "bag") as bag:
        for topic in (raw.topic, truth, depth, "/other/mast/image_raw"):
            bag.write_raw(topic, raw.type_name, raw.raw, raw.log_time_ns)
    taken = [m.topic for m in Selection.open(tmp_path / "bag", small_site.site)]
    assert sorted(taken) == sorted([raw.topic, truth])


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
    played = {message.topic.rsplit("phone/", 1)[1]: selection.inputs.reader.decode(message) for message in selection}
    assert played.keys() == messages.keys()
    assert (played["fix"].latitude, played["fix"].longitude) == (LAT, LON)
    assert played["imu"].orientation.w == 1.0
