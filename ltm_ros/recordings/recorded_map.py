"""Reads the fuel map that a recorded run ended with."""

from __future__ import annotations

from pathlib import Path

from ltm_core.errors import RecordingError
from ltm_core.grid import GridGeometry
from ltm_core.resources import config_path
from ltm_core.site import Site
from ltm_core.types import UInt8Array
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.grid import msg_to_classes
from ltm_ros.runtime.topics import FUEL_MAP, site_topic


def last_fuel_map(bag: Path, site: Site) -> tuple[UInt8Array, GridGeometry, LabelSet]:
    """Class ids (255 unseen), geometry in the site's CRS, and the label set. Raises RecordingError where none is."""
    reader = BagReader(bag)
    topic = site_topic(site.name, FUEL_MAP)
    last = None
    for message in reader.messages([topic]):
        last = message
    if last is None:
        raise RecordingError(f"{bag} holds no {topic}; its topics are {', '.join(sorted(reader.topics())) or '(none)'}")
    classes, geometry = msg_to_classes(reader.decode(last))
    return classes, site.in_crs(geometry), LabelSet.load(config_path(site.labels))
