"""Photos of a recording with the depth traced from their poses, for `ltm-lab train adapt`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ltm_core.base.errors import RecordingError
from ltm_core.site.site_io import load_site
from ltm_lab.training.adapt import frame_of
from ltm_lab.training.training_frames import TrainingFrame
from ltm_msgs_py.image import msg_to_depth, msg_to_rgb
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.recordings.replay.offline import OfflineGraph, Selection
from ltm_ros.runtime.topics import DEPTH_IMAGE, POSED_IMAGE

_NODES = ("capture", "depth")


class _Tracing(OfflineGraph):
    """The nodes that join and trace a recording; keeps each photo, made small, with its depth."""

    def __init__(self, graph: Graph, width: int) -> None:
        self.frames: list[TrainingFrame] = []
        self._width = width
        self._photos: dict[tuple[str, int], Any] = {}
        super().__init__(graph)

    def publish(self, topic: str, message: Any, latched: bool = False) -> None:
        if topic.endswith(f"/{POSED_IMAGE.name}"):
            self._photos[topic.removesuffix(POSED_IMAGE.name), stamp_of(message)] = message
        elif topic.endswith(f"/{DEPTH_IMAGE.name}"):
            place, stamp = topic.removesuffix(DEPTH_IMAGE.name), stamp_of(message)
            photo = self._photos.pop((place, stamp), None)
            if photo is not None:
                name = f"{place.strip('/')}/{stamp}.png"
                self.frames.append(frame_of(msg_to_rgb(photo), msg_to_depth(message), name, self._width))
        super().publish(topic, message, latched)


def traced_frames(bag: Path, site_path: Path, width: int, progress: Callable[[int, int], None]) -> list[TrainingFrame]:
    """Every photo of a recording, `width` wide, with its traced inverse depth, in order of time.

    Raises RecordingError where no photo could be traced.
    """
    site = load_site(site_path)
    selection = Selection.open(bag, site, 0.0, None)
    whole = describe(site, site_path)
    nodes = tuple(node for node in whole if node.executable in _NODES)
    tracing = _Tracing(Graph(whole.site, nodes), width)
    for done, (message, content) in enumerate(selection.decoded(), start=1):
        tracing.feed(message.topic, content, message.log_time_ns)
        progress(done, selection.message_count)
    tracing.finish()
    if not tracing.frames:
        raise RecordingError(f"{bag}: no photo could be traced on site {site.name}; see `ltm replay {bag} --offline`")
    return tracing.frames
