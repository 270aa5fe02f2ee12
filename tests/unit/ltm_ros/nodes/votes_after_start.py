"""Prints how many signatures each kernel is compiled for once `fuel_map` has started, and after frames of votes."""

import json
import sys
from pathlib import Path

import numpy as np
from scenes.fuel_frames import LABELS, camera_of, votes, write_site
from scenes.fuel_map_node import Node
from scenes.kernel_counts import compiled

from ltm_msgs_py.pointcloud import votes_to_msg


def main() -> None:
    node = Node(write_site(Path(sys.argv[1])))
    before = compiled()
    node.feed(0, 3)
    alone = votes(6, node.map.geometry).only(np.arange(1))
    node.handler.on_votes(camera_of(6), votes_to_msg(alone, LABELS.names))
    node.handler.idle()
    assert node.handler.persistence.unsaved_frames == 0
    assert node.handler.persistence.saved_frames == 3
    print(json.dumps([before, compiled()]))


if __name__ == "__main__":
    main()
