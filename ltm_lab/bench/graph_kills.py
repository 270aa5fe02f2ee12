"""`ltm-lab bench kills`: kills each process of a site's graph under load, and tells what became of every frame."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import project_path
from ltm_core.raster.dem_io import prepare_heights
from ltm_core.site.site_io import load_site
from ltm_lab.bench.graph_sender import CameraSender, settle
from ltm_lab.bench.graph_site import NAME, Load, camera_of, write_site
from ltm_lab.bench.listener import Listener
from ltm_ros.launching.graph import describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.ros_environment import apply_to_process

READY_S = 300.0
BACK_S = 120.0
"""The longest wait for frames of every camera after a kill."""
BETWEEN_S = 2.0
"""Of whole work between one return and the next kill."""
IN_FLIGHT_S = 5.0
"""Before a kill: what came then and is not in the map was at work when its process died."""
CHUNK_FRAMES = 10
"""That are sent at a time, until all kills are done."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class Outage:
    """A kill and what followed.

    `killed`: ns of this machine's clock. `back`: of each camera, by its number, the stamp of the first frame from after
    the kill that the map told of. `seconds`: from the kill until it had told of such frames of all cameras.
    """

    killed: int
    back: Mapping[int, int]
    seconds: float


@dataclass(frozen=True)
class Fates:
    """Numbers of frames. `in_flight` and `away`: not in the map, sent shortly before a kill, and while its process was
    away; `otherwise`: not in the map at any other time, `shed` at the door among them."""

    stored: int
    in_flight: int
    away: int
    otherwise: int


def fates(sent: Iterable[int], stored: Container[int], outages: Sequence[Outage]) -> Fates:
    """What became of the frames with these stamps."""
    counts = {"stored": 0, "in_flight": 0, "away": 0, "otherwise": 0}
    for stamp in sent:
        if stamp in stored:
            counts["stored"] += 1
        elif any(o.killed <= stamp < o.back[camera_of(stamp)] for o in outages):
            counts["away"] += 1
        elif any(o.killed - IN_FLIGHT_S * 1e9 <= stamp < o.killed for o in outages):
            counts["in_flight"] += 1
        else:
            counts["otherwise"] += 1
    return Fates(**counts)


class ShedCounter:
    """Sums what `capture` says it has shed over the lives of its process, each of which begins at nought."""

    def __init__(self, summaries: Mapping[str, Mapping[str, str]]) -> None:
        self.total = 0
        self._last = dict(_shed(summaries))

    def read(self, summaries: Mapping[str, Mapping[str, str]]) -> None:
        for node, shed in _shed(summaries):
            last = self._last.get(node, 0)
            self.total += shed - last if shed >= last else shed
            self._last[node] = shed


def _shed(summaries: Mapping[str, Mapping[str, str]]) -> list[tuple[str, int]]:
    return [(node, int(values["dropped.shed"])) for node, values in summaries.items() if "dropped.shed" in values]


@dataclass(frozen=True)
class KillsResult:
    """The kills of one process, while each camera sends `offered_hz` frames a second."""

    process: str
    kills: int
    cameras: int
    offered_hz: float
    sent: int
    frames: Fates
    shed: int
    """That `capture` turned away and said so, as far as it lived to say it."""
    back_median_s: float
    """From the kill until the map told of a frame of every camera that was sent after it."""
    back_most_s: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def run_kills(load: Load, rate: float, kills: int, domain_id: int | None, say: Say) -> list[KillsResult]:
    """Each process of the graph of `load`, with a recorder, `kills` times. Raises LtmError where one does not come
    back."""
    apply_to_process(domain_id)
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as name:
        folder = Path(name)
        traffic = write_site(folder, project_path("bags/demo"), load)
        site = load_site(traffic.site)
        prepare_heights(site.dem.path)  # as `ltm run` does
        graph = describe(
            site,
            traffic.site,
            record={"bag": str(folder / "bag")},
            parameters={"fuel_map": {"folder": str(folder / "kept")}, "terrain": {"folder": str(folder / "kept")}},
        )
        policy = RestartPolicy(maximum_s=RestartPolicy.initial_s)  # each kill is to be the first
        runner = Runner(graph, domain_id=domain_id, log_folder=folder / "log", console=lambda line: None, policy=policy)
        with runner, Listener(NAME) as listener:
            runner.wait_until_ready(READY_S)
            with CameraSender(folder, traffic.cameras, domain_id) as sender:
                settle(listener, sender.stream(2, 2.0 * load.cameras).stamps)
                results = []
                for process in runner.processes:
                    say(f"{process}, {kills} times")
                    results.append(_kill(process, kills, rate, runner, listener, sender))
                return results


def _kill(
    process: str, kills: int, rate: float, runner: Runner, listener: Listener, sender: CameraSender
) -> KillsResult:
    outages: list[Outage] = []
    failed: list[LtmError] = []
    shed = ShedCounter(listener.summaries)
    numbers = range(sender.cameras)

    def kill_again_and_again() -> None:
        try:
            for _ in range(kills):
                time.sleep(BETWEEN_S)
                outages.append(_outage(process, runner, listener, numbers, shed))
        except LtmError as error:
            failed.append(error)

    killer = threading.Thread(target=kill_again_and_again, name="kills", daemon=True)
    killer.start()
    sent: list[int] = []
    while killer.is_alive():
        sent += sorted(sender.stream(CHUNK_FRAMES, 1.0 / rate).stamps)
    if failed:
        raise failed[0]
    settle(listener, set(sent[-sender.cameras :]))
    shed.read(listener.summaries)
    back = [outage.seconds for outage in outages]
    return KillsResult(
        process,
        kills,
        sender.cameras,
        rate,
        len(sent),
        fates(sent, listener.arrived, outages),
        shed.total,
        float(np.median(back)),
        max(back),
    )


def _outage(process: str, runner: Runner, listener: Listener, numbers: range, shed: ShedCounter) -> Outage:
    """Kill it, and wait until the map tells of new frames of every camera. Raises LtmError where it does not."""
    starts = runner.processes[process].starts
    shed.read(listener.summaries)
    killed = time.time_ns()
    if not runner.kill(process):
        raise LtmError(f"{process} was not there to be killed")
    deadline = time.monotonic() + BACK_S
    while True:
        since = {stamp: told for stamp, told in list(listener.arrived.items()) if stamp > killed}
        back = {n: min((s for s in since if camera_of(s) == n), default=0) for n in numbers}
        if all(back.values()) and runner.processes[process].starts > starts:
            return Outage(killed, back, max(since[stamp] for stamp in back.values()) - killed / 1e9)
        if time.monotonic() > deadline:
            raise LtmError(f"{BACK_S:g} s after {process} was killed the map tells of no new frame of every camera")
        shed.read(listener.summaries)
        time.sleep(0.1)
