"""A recording on a small disk of its own: `unshare -m python recording_process.py CASE MOUNT_POINT`."""

import os
import random
import signal
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import Split
from ltm_ros.recordings import bounded_recording
from ltm_ros.recordings.bounded_recording import BoundedRecording, RecordingLimits
from ltm_ros.runtime.health import Health
from scenes.own_disk import answer, fill, make_disk

STRING = "std_msgs/msg/String"
WIDE = Split(1 << 40, 1 << 62)
bounded_recording.RETRY_S = bounded_recording.LONGEST_RETRY_S = 0.0


class Site:
    """Two topics whose messages say their number, in 60 kB that do not get smaller."""

    def __init__(self, disk: Path, floor: int = 0, most: int | None = None, split: Split = WIDE) -> None:
        self.disk, self.health, self.told = disk, Health(), list[str]()
        self.sent = 0
        limits = RecordingLimits(most, floor, split)
        self.recording = BoundedRecording(disk / "bag", "/ridge/recorder", limits, self.health, self.told.append)
        self.recording.add_topic("/ridge/north/image", STRING, False)
        self.recording.add_topic("/ridge/info", STRING, True)
        self.write("/ridge/info", "palette")

    def write(self, topic: str, text: str) -> None:
        self.recording.write(topic, STRING, bytes(serialize_message(String(data=text))), 1_000 + self.sent)

    def send(self, count: int) -> None:
        for _ in range(count):
            noise = random.Random(self.sent).randbytes(30_000).hex()
            self.write("/ridge/north/image", f"{self.sent}:{noise}")
            self.sent += 1
        self.recording.flush()

    def state(self) -> dict[str, Any]:
        summary = self.health.summary()
        return {
            "sent": self.sent,
            "out": int(summary["frames_out"]),
            "dropped": {k.partition(".")[2]: int(v) for k, v in summary.items() if k.startswith("dropped.")},
            "troubled": self.health.troubled,
            "error": summary["last_error"],
            "told": list(self.told),
            "files": sorted(str(p.relative_to(self.disk)) for p in self.disk.rglob("*.mcap")),
        }


def read(bag: Path, others: bool = True) -> dict[str, Any]:
    """The numbers of the images in a bag, by each reader; `others`: also by those that are not ours."""
    ours = BagReader(bag)

    def numbers(texts: list[str]) -> list[int]:
        return [int(text.partition(":")[0]) for text in texts]

    images = [ours.decode(m).data for m in ours.messages(["/ridge/north/image"])]
    found: dict[str, Any] = {"ours": numbers(images), "damage": list(ours.damage)}
    if not others:
        return found
    of_mcap: list[str] = []
    for file in sorted(bag.glob("*.mcap"), key=lambda p: (len(p.name), p.name)):
        with file.open("rb") as stream:
            messages = make_reader(stream, validate_crcs=True).iter_messages(["/ridge/north/image"])
            of_mcap += [m.data[8:-1].decode() for _, _, m in messages]
    with Reader(bag) as reader:
        raw = [bytes(data)[8:-1].decode() for c, _, data in reader.messages() if c.topic == "/ridge/north/image"]
        count = reader.message_count
    return found | {"mcap": numbers(of_mcap), "rosbags": numbers(raw), "count": count}


def full(disk: Path) -> Any:
    """The disk fills up while a chunk is written, and has room again."""
    make_disk(disk, "16m")
    site = Site(disk)
    site.send(31)
    ballast = fill(disk)
    site.send(40)
    states = [site.state()]
    ballast.unlink()
    site.send(31)
    states.append(site.state())
    site.recording.close()
    return [*states, read(disk / "bag")]


def stopped_while_full(disk: Path) -> Any:
    """The recorder is told to stop while the disk is full."""
    make_disk(disk, "16m")
    site = Site(disk)
    site.send(31)
    fill(disk)
    site.write("/ridge/north/image", f"{site.sent}:{'ab' * 1000}")
    site.sent += 1
    whole = site.recording.close()
    return [site.state() | {"whole": whole}, read(disk / "bag")]


def floor(disk: Path) -> Any:
    """Recording stops above a full disk, and starts again when there is a tenth more than the floor."""
    make_disk(disk, "16m")
    site = Site(disk, floor=8_000_000)
    site.send(10)
    ballast = disk / "ballast"
    ballast.write_bytes(bytes(9_000_000))
    site.send(10)
    states = [site.state() | {"read": read(disk / "bag", others=False)["ours"]}]
    while os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize < 8_300_000:
        os.truncate(ballast, ballast.stat().st_size - 100_000)
    site.send(1)
    states.append(site.state())
    ballast.unlink()
    site.send(10)
    site.recording.close()
    return [*states, site.state(), read(disk / "bag")]


def killed(disk: Path) -> Any:
    """A recorder is killed; the next one ends the bag that it left."""
    make_disk(disk, "16m")
    if (child := os.fork()) == 0:
        site = Site(disk, split=Split(500_000, 1 << 62))
        site.send(20)
        site.send(11)
        site.write("/ridge/north/image", "31:" + "ab" * 1000)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    bag = disk / "bag"
    before = read(bag, others=False)
    last = max(bag.glob("*.mcap"), key=lambda p: (len(p.name), p.name))
    with last.open("r+b") as file:
        file.truncate(last.stat().st_size - 1000)  # as the power would cut it
    site = Site(disk)
    site.recording.close()
    left = sorted(p.name for p in bag.iterdir() if not p.name.endswith(".mcap"))
    return [before, site.state(), read(bag), left]


if __name__ == "__main__":
    cases = (full, stopped_while_full, floor, killed)
    answer({case.__name__: case for case in cases})
