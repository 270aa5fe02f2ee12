"""Runs a whole replay: start the graph, play the recording through it, wait until its work is done, stop it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import LtmError
from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import Graph, ParameterValue, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.site_check import Wanted, require_ready
from ltm_ros.recordings.replay import LONGEST_PAUSE
from ltm_ros.recordings.replay.live import LivePlayer
from ltm_ros.recordings.replay.offline import replay_offline
from ltm_ros.recordings.replay.selection import Selection
from ltm_ros.runtime.ros_environment import apply_to_process

NodeParameters = dict[str, ParameterValue]


@dataclass(frozen=True)
class ReplayOptions:
    """`start`, `duration`: seconds of the recording. `export`: GeoTIFF of the fuel map. `record`: bag of the results.

    `state`: an existing folder in which the fuel map, the terrain and the nodes `pose` keep what they know; None: it
    ends with the replay. `rrd`: Rerun recording. `rate`, `loop`, `longest_pause` (`LivePlayer`), `domain_id`: of live
    replay only.
    """

    start: float = 0.0
    duration: float | None = None
    export: Path | None = None
    record: Path | None = None
    state: Path | None = None
    rrd: Path | None = None
    rate: float = 1.0
    loop: bool = False
    longest_pause: float = LONGEST_PAUSE
    domain_id: int | None = None


def graph_of(site_path: Path, options: ReplayOptions, sim_time: bool) -> Graph:
    """The site's graph with what the options ask for."""
    fuel_map: NodeParameters = {}
    if options.export is not None:
        fuel_map["export_path"] = str(options.export.resolve())
    kept: NodeParameters = {}
    if options.state is not None:
        kept["folder"] = str(options.state.resolve())
    return describe(
        load_site(site_path),
        site_path,
        sim_time=sim_time,
        view=None if options.rrd is None else {"save": str(options.rrd.resolve())},
        record=None if options.record is None or not sim_time else {"bag": str(options.record.resolve())},
        parameters={"fuel_map": fuel_map | kept, "terrain": kept, "pose": kept},
        sources=False,
    )


def run_offline(
    bag: Path, site_path: Path, options: ReplayOptions, progress: Callable[[int, int], None]
) -> dict[str, dict[str, str]]:
    """Without DDS; each node's health summary. Raises LtmError on bad input."""
    selection = Selection.open(bag, load_site(site_path), options.start, options.duration)
    graph = graph_of(site_path, options, sim_time=False)
    total = selection.message_count
    return replay_offline(selection, graph, options.record, lambda done: progress(done, total))


def run_live(
    bag: Path,
    site_path: Path,
    options: ReplayOptions,
    progress: Callable[[int, int], None],
    console: Callable[[str], None],
    log_folder: Path,
    stopped: Callable[[], bool] = bool,
) -> dict[str, dict[str, str]]:
    """With the whole graph as processes of their own; the last diagnostics of every node by full name.

    Raises NotReadyError where it cannot work, LtmError when it does not come up or does not finish its work.
    """
    site = require_ready(site_path, Wanted(), console)
    selection = Selection.open(bag, site, options.start, options.duration)
    apply_to_process(options.domain_id)
    graph = graph_of(site_path, options, sim_time=True)
    if options.rrd is not None:
        options.rrd.unlink(missing_ok=True)  # else the viewer would write another beside that of the last replay
    names = [node.full_name for node in graph]
    total = selection.message_count
    with Runner(graph, domain_id=options.domain_id, log_folder=log_folder, console=console) as runner:
        runner.wait_until_ready(timeout_s=180.0)
        with LivePlayer(selection, options.rate, options.longest_pause) as player:
            player.wait_for_listeners(len(graph))
            player.play(options.loop, lambda done: progress(done, total), stopped)
            if not player.drain(names):
                raise LtmError("the graph is still at work two minutes after the recording's end; see its logs")
            runner.stop()
            return dict(player.summaries)
