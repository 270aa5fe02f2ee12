"""Whether the store holds what was acknowledged: every frame once, and the map that follows from exactly these."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scenes.outlets import Kept
from scenes.small_site import NAME, SmallSite

from chaos.cameras import CAMERAS, PHASES, Photos, Sent
from ltm_core.base.resources import config_path
from ltm_core.fuel.cell_state import EVIDENCE_FIELDS
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import JOURNALED, STORE_FILE, open_stored_map
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.stamp import ns_to_time, stamp_of
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.launching.graph import CAMERA_NODES, Graph, describe
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_VOTES, camera_topic

_ALWAYS = 2**62
_FIRST_NS = 1_700_000_000_000_000_000


@dataclass
class Verdict:
    """Of frames, their stamps. All but `untold` must be empty."""

    sent: int = 0
    stored: int = 0
    told: int = 0
    lost: list[int] = field(default_factory=list)
    """Told of, and not in the store."""
    told_twice: list[int] = field(default_factory=list)
    untold: list[int] = field(default_factory=list)
    """In the store, and never told of: the node was killed between the two. They may be sent again."""
    faults: list[str] = field(default_factory=list)
    """Whatever else is not as it must be."""

    @property
    def holds(self) -> bool:
        return not (self.lost or self.told_twice or self.faults)


def votes_of_phases(small: SmallSite, photos: Photos) -> dict[tuple[str, int], Any]:
    """What the cameras' nodes make of each frame, offline, without DDS: by camera and phase."""
    whole = describe(small.site, small.path)
    chain = Graph(NAME, tuple(whole.node(f"{camera}/{kind}") for camera in CAMERAS for kind in CAMERA_NODES))
    stamps = {
        (camera, phase): _FIRST_NS + (number * len(CAMERAS) + CAMERAS.index(camera)) * 10**9
        for number, phase in enumerate(range(PHASES))
        for camera in CAMERAS
    }
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with BagWriter(bag) as record:
            offline = OfflineGraph(chain, record)
            for (camera, phase), stamp in stamps.items():
                for topic, message in photos.messages(camera, phase, stamp).items():
                    offline.feed(camera_topic(NAME, camera, topic), message, stamp)
            offline.finish()
        reader = BagReader(bag)
        topics = {camera_topic(NAME, camera, FUEL_VOTES) for camera in CAMERAS}
        votes = {stamp_of(message): message for message in map(reader.decode, reader.messages(topics))}
    return {key: votes[stamp] for key, stamp in stamps.items()}


def judge(
    small: SmallSite,
    state: Path,
    sent: Sequence[Sent],
    told: Mapping[int, int],
    votes: Mapping[tuple[str, int], Any],
) -> Verdict:
    """Compare the store in the folder `state`, after the graph has stopped, with what was sent and told of.

    `told`: how often each stamp was told of. `votes`: of each camera and phase, see `votes_of_phases`.
    """
    site = small.site
    labels = LabelSet.load(config_path(site.labels))
    grid = site.fuel_geometry(small.dem)
    found = site_evidence_map(site, grid, labels)
    initial = found.layers()
    verdict = Verdict(sent=len(sent), told=len(told))
    known = {frame.stamp_ns for frame in sent}
    verdict.faults += [f"told of {stamp} ns, which nobody sent" for stamp in told if stamp not in known]
    verdict.told_twice = [stamp for stamp, times in told.items() if times > 1]
    with open_stored_map(state / STORE_FILE, site, found) as store:
        stored = [frame for frame in sent if store.counted(frame.camera, frame.stamp_ns)]
        verdict.stored = store.frame_count()
        if verdict.stored != len(stored):
            verdict.faults.append(f"{verdict.stored} frames in the store, {len(stored)} of them were sent")
        if store.waiting():
            verdict.faults.append("frames wait in the store after the node has stopped in order")
        kept = {frame.stamp_ns for frame in stored}
        verdict.lost = [stamp for stamp in told if stamp in known - kept]
        verdict.untold = sorted(kept - told.keys())
        expected = _map_of(small, stored, votes).persistence.map
        for key in np.ndindex(expected.tiles):
            has, wants = found.tile_state(key), expected.tile_state(key)
            verdict.faults += [
                f"tile {key}: {name} differs" for name in EVIDENCE_FIELDS if not np.array_equal(has[name], wants[name])
            ]
        shown = expected.layers()
        for layer in JOURNALED:
            journal = store.as_of(layer, getattr(initial, layer), _ALWAYS)
            if differing := int(np.count_nonzero(journal != getattr(shown, layer))):
                verdict.faults.append(f"{layer} of {differing} cells differs from the map of the frames in the store")
    return verdict


def _map_of(small: SmallSite, frames: Sequence[Sent], votes: Mapping[tuple[str, int], Any]) -> FuelMapHandler:
    """A fuel map, in memory, that has counted these frames."""
    node = FuelMapHandler(FuelMapConfig(site=str(small.path)), Kept(), Health())
    messages = deepcopy(dict(votes))
    for frame in sorted(frames, key=lambda one: one.stamp_ns):
        message = messages[frame.camera, frame.phase]
        message.header.stamp = ns_to_time(frame.stamp_ns)
        node.on_votes(frame.camera, message)
    node.finish()
    return node
