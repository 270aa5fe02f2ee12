import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from bystander import Bystander
from scenes.small_site import NAME, TOWER, SmallSite
from scenes.terrain_frames import write_fusing_site
from scenes.waiting import wait_for

from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.topics import CAMERA_INFO, FUEL_VOTES, IMAGE_COMPRESSED, IMAGE_RAW, POSE, camera_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

CAMERAS = ("tower", "mast")
WORKERS = ("depth", "segmentation", "topodepth", "fuel_votes")
DONE_S = 600.0
"""For all that was let in to be done; whoever waits for it in vain waits as long."""
FRAMES, RATE_HZ = 45, 30.0
"""Of each camera: several times what two cores can fuse."""
BURST = 5
"""Frames at once: more than a door lets in, and their messages all fit before it."""
MESSAGES = {"tower": 3, "mast": 1}
"""Of a frame; the site file has what else is known of the mast's."""


class Cameras:
    """Both cameras of the site, offering frames; a bystander that hears what the nodes say of them."""

    def __init__(self, small: SmallSite, runner: Runner, bystander: Bystander) -> None:
        self.runner, self.bystander = runner, bystander
        tower, mast = small.frames(1)
        self._pose, self._jpeg, self._photo = tower.pose, encode_rgb(small.photo(tower), quality=95), small.photo(mast)
        self.sent: dict[str, list[int]] = {camera: [] for camera in CAMERAS}

    def offer(self) -> None:
        """A frame of each camera, of now."""
        stamp = time.time_ns()
        for topic, message in (
            (CAMERA_INFO, camera_to_msg(TOWER, stamp, "tower_optical")),
            (POSE, pose_to_msg(self._pose, stamp)),
            (IMAGE_COMPRESSED, compressed_to_msg(self._jpeg, "jpeg", stamp, "tower_optical")),
        ):
            self.bystander.send(camera_topic(NAME, "tower", topic), message)
        photo = image_to_msg(self._photo, "rgb8", stamp, "mast_optical")
        self.bystander.send(camera_topic(NAME, "mast", IMAGE_RAW), photo)
        for camera in CAMERAS:
            self.sent[camera].append(stamp)

    @contextmanager
    def streaming(self, rate_hz: float, burst: int = 1) -> Iterator[None]:
        """`burst`: frames at once; the rate stays."""
        stopping = threading.Event()

        def stream() -> None:
            while not stopping.wait(burst / rate_hz):
                for _ in range(burst):
                    self.offer()

        thread = threading.Thread(target=stream)
        thread.start()
        try:
            yield
        finally:
            stopping.set()
            thread.join()

    def count(self, camera: str, node: str, *keys: str) -> int:
        return sum(self.bystander.count(f"/{NAME}/{camera}/{node}", key) for key in keys)

    def taken(self) -> bool:
        """Every message has come to the doors and been looked at, or is counted as one that did not fit."""
        return all(
            self.count(camera, "capture", "received", "dropped.lost") == MESSAGES[camera] * len(sent)
            and self.count(camera, "capture", "queue") == 0
            for camera, sent in self.sent.items()
        )

    def settled(self) -> bool:
        """Every frame that was sent has been finished or counted, and the nodes' diagnostics tell of it."""
        for camera, sent in self.sent.items():
            admitted = self.count(camera, "capture", "frames_out")
            gone = len(sent) - admitted - self.count(camera, "capture", "dropped.shed")
            # What does not fit before the door is counted by messages: a frame may have lost one or all of them.
            others = self.count(camera, "capture", "dropped") - self.count(camera, "capture", "dropped.shed")
            if not 0 <= gone <= others or self.count(camera, "capture", "waiting"):
                return False
            if any(self.count(camera, node, "frames_out") != admitted for node in WORKERS):
                return False
        return self.taken()


@pytest.fixture(scope="module")
def cameras(module_ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cameras]:
    folder = tmp_path_factory.mktemp("overload")
    small = write_fusing_site(folder, recording=False)
    site = small.site.model_copy(update={"processes": "site"})
    whole = describe(site, small.path)
    labels = ["terrain", *(f"{camera}/{node}" for camera in CAMERAS for node in ("capture", *WORKERS))]
    runner = Runner(
        Graph(NAME, tuple(map(whole.node, labels))),
        domain_id=module_ros_domain,
        console=lambda line: None,
        policy=RestartPolicy(initial_s=0.1, maximum_s=1.0),
    )
    with runner, Bystander() as bystander:
        runner.wait_until_ready(300.0)
        for camera in CAMERAS:
            bystander.listen(camera_topic(NAME, camera, FUEL_VOTES), FUEL_VOTES.type, depth=200)
        for topic in (CAMERA_INFO, POSE, IMAGE_COMPRESSED):
            bystander.open(camera_topic(NAME, "tower", topic), topic.type)
        bystander.open(camera_topic(NAME, "mast", IMAGE_RAW), IMAGE_RAW.type)
        bystander.wait_for_wiring(len(labels))
        yield Cameras(small, runner, bystander)


def test_what_is_let_in_is_finished_everywhere(cameras: Cameras) -> None:
    with cameras.streaming(RATE_HZ, BURST):  # more than can be done, also where the sender itself hardly gets on
        wait_for(
            lambda: (
                len(cameras.sent["mast"]) >= FRAMES
                and all(cameras.count(camera, "fuel_votes", "frames_out") > 5 for camera in CAMERAS)
                and all(cameras.count(camera, "capture", "dropped.shed") > 0 for camera in CAMERAS)
            ),
            "the frames to be sent, an overload, and some of each camera to be done all the same: none starves",
            lambda: cameras.bystander.summaries,
            patience_s=DONE_S,
        )
    wait_for(cameras.taken, "all messages to be looked at", lambda: cameras.bystander.summaries, patience_s=DONE_S)
    for _ in range(BURST):
        cameras.offer()
    wait_for(
        cameras.settled, "every frame to be finished or counted", lambda: cameras.bystander.summaries, patience_s=DONE_S
    )
    summaries = cameras.bystander.summaries
    for camera, sent in cameras.sent.items():
        finished = cameras.count(camera, "capture", "frames_out")
        assert finished > 5
        # Nothing was dropped behind the door, and no frame is a part of one.
        for node in WORKERS:
            assert cameras.count(camera, node, "dropped", "noted.unlabelled") == 0, (camera, node, summaries)
        topic = camera_topic(NAME, camera, FUEL_VOTES)
        wait_for(lambda t=topic, n=finished: len(cameras.bystander.stamps(t)) >= n, "votes of all", lambda: summaries)
        votes = cameras.bystander.stamps(topic)
        assert len(votes) == finished
        assert votes == sorted(votes)
        assert votes[-1] == sent[-1], "the newest is not lost when the camera falls silent"
    frames = [cameras.count(camera, "capture", "frames_out") for camera in CAMERAS]
    terrain = f"/{NAME}/terrain"
    wait_for(
        lambda: sum(cameras.bystander.count(terrain, key) for key in ("frames", "dropped")) >= sum(frames),
        "each frame to be in the terrain, or a part of it to be counted as dropped there",
        lambda: summaries,
    )
    assert 0 < cameras.bystander.count(terrain, "frames") <= sum(frames)
