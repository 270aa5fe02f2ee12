import queue
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from sensor_msgs.msg import CompressedImage

from ltm_core.base.errors import ImageError
from ltm_msgs_py.stamp import make_header, stamp_of
from ltm_ros.runtime.camera_pipeline import INBOX, INBOX_BYTES, CameraPipeline, FrameScheduler
from ltm_ros.runtime.handler import Handler, NodeConfig, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.heartbeat import Activity, Heartbeat
from ltm_ros.runtime.pipeline import Job
from ltm_ros.runtime.stamp_join import StampJoin

PHOTO, POSED, LABELS, FUSED = (Topic(name, CompressedImage) for name in ("photo", "posed", "labels", "fused"))
STATE = Topic("state", CompressedImage, latched=True)
BAD, BUG = 30, 40
"""Stamps of a photo that the labeller refuses, and of one that it is not able to do."""


class Outlet:
    """Hands over within one pipeline, and keeps what was published."""

    def __init__(self, camera: CameraPipeline, health: Health, sent: list[tuple[str, int]]) -> None:
        self._camera, self._health, self._sent = camera, health, sent

    def publish(self, topic: Topic, message: Any) -> None:
        self._sent.append((topic.name, stamp_of(message)))
        self._health.published(topic.name)
        self._camera.pipeline.publish(f"/s/c/{topic.name}", message)

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        self.publish(topic, make())

    def wanted(self, topic: Topic) -> bool:
        return True

    def more_waits(self) -> bool:
        return self._camera.more_waits

    def now_ns(self) -> int:
        return 0


class Door(Handler[NodeConfig]):
    publications = (POSED,)

    newest: Any = None

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {PHOTO: self.on_photo}

    def on_photo(self, photo: Any) -> None:
        if self.newest is not None:
            self.health.drop("shed", "a newer one waits")
        self.newest = photo
        if not self.outlet.more_waits():
            self.idle()

    def idle(self) -> None:
        if self.newest is not None:
            photo, self.newest = self.newest, None
            self.outlet.publish(POSED, photo)

    def finish(self) -> None:
        if self.newest is not None:
            self.health.drop("shed", "the node ended")


class Label(Handler[NodeConfig]):
    publications = (LABELS,)
    state = 0

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {POSED: self.on_photo, STATE: self.on_state}

    def on_state(self, message: Any) -> None:
        self.state = stamp_of(message)

    def on_photo(self, photo: Any) -> None:
        stamp = stamp_of(photo)
        if stamp == BAD:
            raise ImageError("too dark")
        if stamp == BUG:
            raise IndexError("of nothing")
        self.outlet.publish(LABELS, photo)


class Fuse(Handler[NodeConfig]):
    publications = (FUSED, STATE)

    def __init__(self, config: NodeConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        self.join = StampJoin(("photo", "labels"), self._fuse, health)

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {
            POSED: lambda m: self.join.add("photo", stamp_of(m), m),
            LABELS: lambda m: self.join.add("labels", stamp_of(m), m),
        }

    def discard(self, stamp_ns: int) -> None:
        self.join.discard(stamp_ns)

    def finish(self) -> None:
        self.join.finish()

    def _fuse(self, photo: Any, labels: Any) -> None:
        self.outlet.publish(FUSED, photo)
        self.outlet.publish(STATE, photo)


class Camera:
    def __init__(self) -> None:
        self.said: list[tuple[str, str]] = []
        self.pipeline = CameraPipeline(lambda name, text: self.said.append((name, text)))
        self.sent: list[tuple[str, int]] = []
        self.jobs = {name: self._job(name, kind) for name, kind in (("door", Door), ("label", Label), ("fuse", Fuse))}
        for job in self.jobs.values():
            self.pipeline.pipeline.add(job)

    def offer(self, *stamps: int, size: int = 10) -> None:
        for stamp in stamps:
            photo = CompressedImage(header=make_header(stamp, "c"), data=bytes(size))
            self.pipeline.offer(self.jobs["door"], PHOTO, photo)

    def turn(self) -> bool:
        return self.pipeline.turn(Activity("worker"))

    @property
    def fused(self) -> list[int]:
        return [stamp for topic, stamp in self.sent if topic == FUSED.name]

    def count(self, job: str, *keys: str) -> int:
        summary = self.jobs[job].health.summary()
        return sum(int(summary.get(key, "0")) for key in keys)

    def _job(self, name: str, kind: type[Handler[NodeConfig]]) -> Job:
        health = Health()
        outlet = Outlet(self.pipeline, health, self.sent)
        return Job(name, "/s/c", health, kind(NodeConfig(site="s"), outlet, health))


def test_of_what_waits_the_newest_runs_straight_through() -> None:
    camera = Camera()
    camera.offer(11, 12, 13)
    assert camera.turn()
    assert camera.sent == [("posed", 13), ("labels", 13), ("fused", 13), ("state", 13)]
    assert camera.jobs["door"].health.dropped == {"shed": 2}
    assert not camera.turn()
    camera.offer(15)
    camera.turn()
    assert camera.fused == [13, 15]


def test_what_a_job_refuses_is_counted_and_the_next_frame_goes_through() -> None:
    camera = Camera()
    for stamp in (BAD, 31):
        camera.offer(stamp)
        camera.turn()
    camera.turn()
    assert camera.fused == [31]
    assert camera.jobs["label"].health.dropped == {"image": 1}
    assert camera.said == [("label", "too dark")]


def test_a_bug_costs_its_frame(capsys: pytest.CaptureFixture[str]) -> None:
    camera = Camera()
    camera.offer(BUG)
    camera.turn()
    assert camera.fused == []
    label = camera.jobs["label"].health
    assert label.dropped == {"crash": 1}
    assert "IndexError('of nothing'): internal error" in label.last_error
    assert "in on_photo" in capsys.readouterr().err
    camera.offer(41)
    camera.turn()
    camera.turn()
    assert camera.fused == [41]
    # Nothing of the lost frame waits anywhere for the rest of it.
    camera.pipeline.finish()
    assert camera.jobs["fuse"].health.dropped == {}


def test_one_cameras_bugs_and_floods_cost_another_no_frame() -> None:
    ill, well = Camera(), Camera()
    scheduler = FrameScheduler(2, Heartbeat())
    for stamp in range(100, 120):
        ill.offer(BUG, BUG, (stamp % 2 and BAD) or BUG)
        well.offer(stamp)
        # In turns, so that no frame of the second camera is shed.
        ill.turn()
        well.turn()
    scheduler.start()
    for camera in (ill, well):
        scheduler.wake(camera.pipeline)
    assert scheduler.close(30.0)
    assert well.fused == list(range(100, 120))
    assert ill.fused == []
    assert ill.count("label", "dropped.crash") > 0


def test_what_waits_for_a_turn_is_bounded() -> None:
    camera = Camera()
    camera.offer(*range(1, INBOX + 1), size=0)
    with pytest.raises(queue.Full):
        camera.offer(INBOX + 1)
    camera.turn()
    assert camera.fused == [INBOX]
    camera.offer(2000, size=INBOX_BYTES + 1)
    with pytest.raises(queue.Full):
        camera.offer(2001)
