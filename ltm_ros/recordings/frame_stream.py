"""Stream the frames of a bag, joined by camera and stamp, in bounded memory.

A first pass over the bag reads only stamps and counts the messages of each frame; the second returns a frame as soon as
its last message has come. So memory holds only frames that overlap in time, whatever the length of the bag."""

import logging
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from ltm_core.base.errors import RecordingError
from ltm_core.site.site import Site
from ltm_msgs_py.bag.cdr import header_of
from ltm_msgs_py.bag.reader import BagMessage, BagReader
from ltm_msgs_py.image import compressed_to_rgb, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_ros.recordings.inputs import accepted_types, decoded_input
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import Topic

Take = Callable[[Any], Any]
Parts = Mapping[str, tuple[tuple[Topic, Take], ...]]
"""Name of a part -> its topics, each with the function that decodes its messages."""


_mono8 = partial(msg_to_array, encodings=("mono8",))
PARTS: Parts = {
    "camera": ((topics.CAMERA_INFO, msg_to_camera),),
    "depth_camera": ((topics.DEPTH_CAMERA_INFO, msg_to_camera),),
    "pose": ((topics.POSE, msg_to_pose), (topics.POSED_POSE, msg_to_pose)),
    "photo": ((topics.IMAGE_COMPRESSED, compressed_to_rgb), (topics.IMAGE_RAW, msg_to_rgb)),
    "traced": ((topics.DEPTH_IMAGE, msg_to_depth),),
    "network": ((topics.NETWORK_DEPTH, msg_to_depth),),
    "fused": ((topics.FUSED_DEPTH, msg_to_depth),),
    "labels": ((topics.LABELS_IMAGE, _mono8),),
    "votes": ((topics.FUEL_VOTES, lambda m: m),),
    "truth_camera": ((topics.TRUTH_CAMERA_INFO, msg_to_camera),),
    "truth_depth": ((topics.TRUTH_DEPTH, msg_to_depth),),
    "truth_ground": ((topics.TRUTH_GROUND_DEPTH, msg_to_depth),),
    "truth_labels": ((topics.TRUTH_LABELS, _mono8),),
}
"""The parts that our nodes and importers write."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class StreamedFrame:
    """The messages of one frame in a bag. Parts are decoded on request."""

    camera_name: str
    stamp_ns: int
    _raw: Mapping[str, tuple[BagMessage, Topic, Take]]
    _taken: dict[str, Any] = field(default_factory=dict)

    def __contains__(self, part: str) -> bool:
        return part in self._raw

    def take(self, part: str) -> Any:
        """Return the part, decoded once; None if the bag lacks it. Raises RecordingError, ImageError."""
        if part not in self._raw:
            return None
        if part not in self._taken:
            message, topic, take = self._raw[part]
            self._taken[part] = take(decoded_input(topic, message.raw, message.type_name))
        return self._taken[part]


class FrameStream:
    """The frames of a site's cameras."""

    def __init__(self, bag: Path, site: Site, parts: Parts = PARTS, cameras: Collection[str] | None = None) -> None:
        """Open a bag; `cameras`: None for all of the site. Raises RecordingError."""
        self._reader = BagReader(bag)
        self._topics: dict[str, tuple[str, str, Topic, Take]] = {}
        recorded = self._reader.topics()
        for camera in site.cameras if cameras is None else cameras:
            for part, sources in parts.items():
                for topic, take in sources:
                    own = topics.input_topic(site.cameras[camera], topic)
                    name = topics.camera_topic(site.name, camera, own)
                    if recorded.get(name) in accepted_types(topic):
                        self._topics[name] = (camera, part, topic, take)
        self._messages: Counter[tuple[str, int]] = Counter()
        self._parts: dict[tuple[str, int], set[str]] = defaultdict(set)
        for camera, part, _, stamp, _ in self._stamped(list(self._topics)):
            self._messages[camera, stamp] += 1
            self._parts[camera, stamp].add(part)

    def _stamped(self, names: Collection[str]) -> Iterator[tuple[str, str, Topic, int, BagMessage]]:
        """Yield messages with camera, part, topic and stamp, without those of another type or without a header."""
        for message in self._reader.messages(names):
            camera, part, topic, _ = self._topics[message.topic]
            if message.type_name not in accepted_types(topic) or message.encoding != "cdr":
                continue
            try:
                stamp, _ = header_of(message.raw)
            except RecordingError as error:
                _log.warning("%s at %s ns: %s", message.topic, message.log_time_ns, error)
                continue
            yield camera, part, topic, stamp, message

    @property
    def topics(self) -> str:
        """Return the bag's topics and types, for error messages."""
        return ", ".join(f"{name} ({kind})" for name, kind in sorted(self._reader.topics().items())) or "(none)"

    def has(self, part: str) -> bool:
        """Return whether the bag has this part of any frame."""
        return any(part in parts for parts in self._parts.values())

    def frames(self, needed: Collection[str] = (), cameras: Collection[str] | None = None) -> Iterator[StreamedFrame]:
        """Yield frames that have the `needed` parts; each camera's in time order."""
        chosen = [t for t, (camera, *_) in self._topics.items() if cameras is None or camera in cameras]
        due: dict[str, deque[int]] = defaultdict(deque)
        for camera, stamp in sorted(key for key, parts in self._parts.items() if parts.issuperset(needed)):
            due[camera].append(stamp)
        waiting: dict[tuple[str, int], dict[str, tuple[BagMessage, Topic, Take]]] = defaultdict(dict)
        missing = Counter(self._messages)
        for camera, part, topic, stamp, message in self._stamped(chosen):
            key = (camera, stamp)
            if not self._parts[key].issuperset(needed):
                continue
            waiting[key][part] = (message, topic, self._topics[message.topic][-1])
            missing[key] -= 1
            while due[camera] and missing[camera, due[camera][0]] == 0:
                stamp = due[camera].popleft()
                yield StreamedFrame(camera, stamp, waiting.pop((camera, stamp)))
