import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from bystander import Bystander
from leftovers import ports_of_process
from scenes.small_site import BEGIN_NS, FRAMES, NAME, SmallSite
from scenes.waiting import wait_for

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.cdr import transforms_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.recordings.replay.offline import Selection
from ltm_ros.recordings.replay.run import LivePlayer
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import (
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    FUEL_MAP_UPDATE,
    FUEL_VOTES,
    LABELS_IMAGE,
    POSED_POSE,
    camera_topic,
    site_topic,
)

pytestmark = pytest.mark.graph

CAMERAS = ("tower", "mast")


@dataclass(frozen=True, eq=False)
class Replayed:
    """A graph that still runs after a replay, and what it left."""

    small: SmallSite
    runner: Runner
    bystander: Bystander
    summaries: dict[str, dict[str, str]]
    """Diagnostics of every node at the replay's end."""
    out: Path

    @property
    def pids(self) -> dict[str, int | None]:
        return {label: process.pid for label, process in self.runner.processes.items()}


@pytest.fixture(scope="module")
def replayed(
    small_site: SmallSite, module_ros_domain: int, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Replayed]:
    """The small recording has gone through the graph; recorder and viewer have finished their files and run again."""
    out = tmp_path_factory.mktemp("replayed")
    (out / "map").mkdir()
    lines: list[str] = []
    graph = describe(
        small_site.site,
        small_site.path,
        sim_time=True,
        view={"save": str(out / "view.rrd")},
        record={"bag": str(out / "recording")},
        parameters={"fuel_map": {"export_path": str(out / "map" / "fuel_map.tif")}},
    )
    runner = Runner(
        graph, domain_id=module_ros_domain, console=lines.append, policy=RestartPolicy(initial_s=0.1, maximum_s=1.0)
    )
    with runner, Bystander() as bystander:
        runner.wait_until_ready(120.0)
        # Slowly, in five seconds: a queue holds ten messages, and other tests may take the cores from who reads them.
        with LivePlayer(Selection.open(small_site.bag, small_site.site), rate=0.25) as player:
            player.wait_for_listeners(len(graph), 60.0)
            player.play()
            assert player.drain([node.full_name for node in graph]), player.summaries
            summaries = dict(player.summaries)
        finish_files(runner)
        yield Replayed(small_site, runner, bystander, summaries, out)
        assert not [line for line in lines if "Traceback" in line], "\n".join(lines)


def test_recording_holds_every_frame_with_its_results(replayed: Replayed) -> None:
    small = replayed.small
    reader = BagReader(replayed.out / "recording", allow_damaged=False)
    for camera in CAMERAS:
        stamps = [frame.stamp_ns for frame in small.frames() if frame.camera_name == camera]
        for topic in (POSED_POSE, DEPTH_IMAGE, DEPTH_CAMERA_INFO, LABELS_IMAGE, FUEL_VOTES):
            assert [stamp_of(message) for message in recorded(reader, camera, topic)] == stamps, (camera, topic)
    given = BagReader(small.bag)
    for topic in given.topics():
        assert decoded(reader, topic) == decoded(given, topic), topic
    moving, static = (
        {(one.header.frame_id, one.child_frame_id, stamp_of(one)) for m in found for one in transforms_of(m.raw)}
        for found in (reader.messages(["/tf"]), reader.messages(["/tf_static"]))
    )
    assert moving == {("map", f"{frame.camera_name}_link", frame.stamp_ns) for frame in small.frames()}
    assert static == {(f"{camera}_link", f"{camera}_optical", 0) for camera in CAMERAS}


def test_viewer_has_written_every_frame(replayed: Replayed) -> None:
    pytest.importorskip("rerun", reason="the viewer's extra is not installed")
    assert photos_in(replayed.out / "view.rrd") == dict.fromkeys(CAMERAS, FRAMES)


WORK = {
    "cameras": (camera_topic(NAME, "tower", FUEL_VOTES), FUEL_VOTES),
    "fuel_map": (site_topic(NAME, FUEL_MAP_UPDATE), FUEL_MAP_UPDATE),
}
"""The topic that shows the work of a process."""
KILLED_TOGETHER = (("cameras", "recorder"), ("fuel_map", "viewer"))


def test_killed_nodes_come_back_and_the_others_run_on(replayed: Replayed, tmp_path: Path) -> None:
    small, runner, bystander, out = replayed.small, replayed.runner, replayed.bystander, replayed.out
    bag = small.write_bag(tmp_path / "later", begin_ns=BEGIN_NS + 3600 * 10**9)
    for name, topic in WORK.values():
        bystander.listen(name, topic.type)
    before = replayed.pids
    again: dict[str, int] = {}

    def wait_for_work(victim: str, since_ns: int) -> None:
        if victim in WORK:
            name, process = WORK[victim][0], runner.processes[victim]
            wait_for(
                lambda: max(bystander.stamps(name), default=0) > since_ns,
                f"work of {victim} after its restart",
                lambda: (ports_of_process(process.pid), ports_of_process(os.getpid()), bystander.summaries),
            )
        elif victim == "viewer":
            # Its counters began anew, in a process that did not see the frames before; frames of each camera come once
            # it and they have found each other.
            full = f"/{NAME}/{victim}"
            bystander.forget()
            bystander.wait_for_wiring(len(runner.graph))
            seen = bystander.count(full, "frames_in")
            wait_for(
                lambda: bystander.count(full, "frames_in") > seen + 6,
                f"frames at {victim} after its restart",
                lambda: bystander.summaries,
            )
        else:
            wait_for_depths("recording_2")

    def wait_for_depths(name: str) -> None:
        """On disk, of every camera."""
        wait_for(
            lambda: len(cameras_recorded(out / name)) == len(CAMERAS), f"depths in {name}", lambda: bystander.summaries
        )

    # No faster than it takes to see that all work.
    with looping(LivePlayer(Selection.open(bag, small.site), rate=0.5), len(runner.graph)) as player:
        for victims in KILLED_TOGETHER:
            others = {label: pid for label, pid in replayed.pids.items() if label not in victims}
            starts = {victim: runner.processes[victim].starts for victim in victims}
            if "recorder" in victims:
                wait_for_depths("recording_1")
            for victim in victims:
                assert runner.processes[victim].signal(signal.SIGKILL)
            for victim in victims:
                process = runner.processes[victim]
                wait_for(lambda p=process, n=starts[victim]: p.starts == n + 1 and p.running, f"{victim} again")
                assert process.last_exit == "killed by SIGKILL"
                # Whatever carries a later stamp than this has been made by the new process.
                again[victim] = player.now_ns()
            for victim in victims:
                wait_for_work(victim, again[victim])
            assert {label: pid for label, pid in replayed.pids.items() if label not in victims} == others, victims
        newest = player.now_ns()
        wait_for(lambda: max(bystander.stamps(WORK["cameras"][0]), default=0) > newest, "votes at the very end")
    assert all(pid != before[label] for label, pid in replayed.pids.items())
    assert runner.failing == []
    finish_files(runner)

    # What was written before a kill is there, ended by the next recorder, and after it a new bag goes on.
    for bag in ("recording_1", "recording_2"):
        assert BagReader(out / bag, allow_damaged=False).damage == ()
    until, since = recorded_depths(out / "recording_1"), recorded_depths(out / "recording_2")
    for camera in CAMERAS:
        assert until[camera][-1] < again["recorder"] < since[camera][-1]
    pytest.importorskip("rerun", reason="the viewer's extra is not installed")
    assert min(photos_in(out / "view_2.rrd").values()) > 0


def finish_files(runner: Runner) -> None:
    """Let recorder and viewer end as on a clean stop; the runner starts them again."""
    processes = [runner.processes[label] for label in ("recorder", "viewer")]
    starts = [process.starts for process in processes]
    for process in processes:
        # One that has come back a moment ago may just be starting.
        wait_for(lambda p=process: p.signal(signal.SIGINT), f"{process.label} to run")
    for process, former in zip(processes, starts, strict=True):
        wait_for(lambda p=process, n=former: p.starts > n and p.running, f"{process.label} again")


def recorded_depths(bag: Path) -> dict[str, list[int]]:
    """Stamps of each camera's depth images in a bag."""
    reader = BagReader(bag, allow_damaged=False)
    return {camera: [stamp_of(m) for m in recorded(reader, camera, DEPTH_IMAGE)] for camera in CAMERAS}


def cameras_recorded(bag: Path) -> set[str]:
    """Of which cameras depth is on disk already, in a bag that may be missing, empty or unfinished."""
    try:
        reader = BagReader(bag)
        return {
            camera
            for camera in CAMERAS
            if next(iter(reader.messages([camera_topic(NAME, camera, DEPTH_IMAGE)])), None) is not None
        }
    except RecordingError:
        return set()


@contextmanager
def looping(player: LivePlayer, nodes: int) -> Iterator[LivePlayer]:
    """Plays round after round in a thread of its own."""
    stopping = threading.Event()
    with player:
        player.wait_for_listeners(nodes, 60.0)
        thread = threading.Thread(target=lambda: player.play(loop=True, stopped=stopping.is_set))
        thread.start()
        try:
            yield player
        finally:
            stopping.set()
            thread.join()


def recorded(reader: BagReader, camera: str, topic: Topic) -> list[Any]:
    """Messages of a camera's topic, by their stamps."""
    return decoded(reader, camera_topic(NAME, camera, topic))


def decoded(reader: BagReader, topic: str) -> list[Any]:
    return sorted((reader.decode(m) for m in reader.messages([topic])), key=stamp_of)


def photos_in(path: Path) -> dict[str, int]:
    """How many photos of each camera a Rerun recording holds."""
    from rerun.chunk import RrdReader

    counts = dict.fromkeys(CAMERAS, 0)
    for chunk in RrdReader(str(path)).stream():
        for camera in CAMERAS:
            if str(chunk.entity_path) == f"/map/cameras/{camera}/photo":
                counts[camera] += chunk.to_record_batch().num_rows
    return counts
