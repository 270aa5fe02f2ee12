"""Selects the messages of a bag that a replay plays: a site's input topics, and a span of time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import RecordingError
from ltm_core.site.site import Site
from ltm_msgs_py.bag.reader import BagMessage, BagReader
from ltm_ros.runtime.topics import CAMERA_INPUTS, CAMERA_TRUTH, camera_topic


@dataclass(frozen=True)
class Selection:
    """The input topics of a site's cameras in a bag, and a span of its time.

    `start`, `duration`: seconds from the bag's first message. What the graph itself publishes is never replayed.
    """

    reader: BagReader
    types: dict[str, str]
    """Type by topic."""
    begin_ns: int
    end_ns: int
    """One past the last message's log time."""
    message_count: int
    frame_count: int

    @classmethod
    def open(
        cls, bag: Path, site: Site, start: float = 0.0, duration: float | None = None, truth: bool = True
    ) -> Selection:
        """Raises RecordingError where the bag has no image of any camera of the site, or nothing in the span."""
        reader = BagReader(bag)
        recorded = reader.topics()
        wanted = [*CAMERA_INPUTS, *(CAMERA_TRUTH if truth else ())]
        names = [camera_topic(site.name, camera, topic) for camera in site.cameras for topic in wanted]
        types = {name: recorded[name] for name in names if name in recorded}
        images = [name for name in types if "/image_raw" in name]
        if not images or reader.start_ns is None or reader.end_ns is None:
            raise RecordingError(
                f"{bag} holds no images of site {site.name} ({', '.join(site.cameras)}); its topics are "
                f"{', '.join(sorted(recorded)) or '(none)'}: name the site and its cameras as the recording does"
            )
        begin = reader.start_ns + round(start * 1e9)
        end = reader.end_ns + 1 if duration is None else min(begin + round(duration * 1e9), reader.end_ns + 1)
        whole = start == 0 and duration is None and not reader.damage
        counts = (
            Counter({topic: reader.topic_infos()[topic].message_count for topic in types})
            if whole  # the bag's index knows; a part, or a bag that is cut, must be read
            else Counter(message.topic for message in reader.messages(list(types), begin, end))
        )
        if not counts.total():
            raise RecordingError(
                f"{bag} holds nothing between {start} s and {(end - reader.start_ns) / 1e9:.1f} s; "
                f"it is {(reader.end_ns - reader.start_ns) / 1e9:.1f} s long"
            )
        frames = sum(counts[topic] for topic in images)
        return cls(reader, types, begin, end, counts.total(), frames)

    def __iter__(self) -> Iterator[BagMessage]:
        return self.reader.messages(list(self.types), self.begin_ns, self.end_ns)

    @property
    def seconds(self) -> float:
        return (self.end_ns - self.begin_ns) / 1e9
