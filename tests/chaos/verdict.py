"""Whether the store holds what was acknowledged: every frame once, and the map that follows from exactly these."""

import tempfile
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from scenes.outlets import Kept
from scenes.small_site import NAME, SmallSite

from chaos.cameras import CAMERAS, PHASES, Photos, Sent
from ltm_core.base.resources import config_path
from ltm_core.fuel.evidence import EVIDENCE_FIELDS
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
    small: SmallSite, state: Path, sent: Sequence[Sent], announced: Mapping[int, Sequence[float]], photos: Photos
) -> list[str]:
    """Compare the store in the folder `state`, after the graph has stopped, with what was sent and announced.

    `announced`: times at which each stamp was announced. A stored frame may lack an announcement: the node was killed
    between the two.
    """
    site = small.site
    found = site_evidence_map(site, site.fuel_geometry(small.dem), LabelSet.load(config_path(site.labels)))
    initial = found.layers()
    known = {frame.stamp_ns for frame in sent}
    missed = [f"stamp {stamp} ns was announced, but never sent" for stamp in announced if stamp not in known]
    missed += [f"stamp {stamp} ns was announced twice" for stamp, times in announced.items() if len(times) > 1]
    with open_stored_map(state / STORE_FILE, site, found) as store:
        stored = [frame for frame in sent if store.counted(frame.camera, frame.stamp_ns)]
        kept = {frame.stamp_ns for frame in stored}
        print(f"{len(sent)} frames sent, {len(stored)} in the store, {len(announced)} announced")
        missed += [f"stamp {stamp} ns was announced, but is not stored" for stamp in announced if stamp in known - kept]
        if (count := store.frame_count()) != len(stored):
            missed.append(f"{count} frames in the store, {len(stored)} of them were sent")
        if store.waiting():
            missed.append("frames wait in the store after the node has stopped in order")
        expected = _map_of(small, stored, votes_of_phases(small, photos)).persistence.map
        for key in expected.tiles_of((0, 0, *expected.geometry.shape)):
            has, wants = found.tile_state(key), expected.tile_state(key)
            missed += [
                f"tile {key}: {name} differs" for name in EVIDENCE_FIELDS if not np.array_equal(has[name], wants[name])
            ]
        shown = expected.layers()
        for layer in JOURNALED:
            journal = store.as_of(layer, getattr(initial, layer), _ALWAYS)
            if differing := int(np.count_nonzero(journal != getattr(shown, layer))):
                missed.append(f"{layer} of {differing} cells differs from the map of the frames in the store")
    return missed


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
