"""The frames of a recording that carry truth, as core types."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ltm_core.site.site import Site
from ltm_lab.frames.truth_frames_io import TruthFrame
from ltm_ros.recordings.frame_stream import FrameStream


def recorded_truth_frames(bag: Path, site: Site) -> Iterator[TruthFrame]:
    """The frames of a bag that have photo, calibration, pose and truth. Raises RecordingError, ImageError."""
    for frame in FrameStream(bag, site).frames(("pose", "photo", "truth_depth", "truth_ground", "truth_labels")):
        camera = frame.take("camera") or frame.take("depth_camera")
        if camera is None:
            continue
        surface = frame.take("truth_depth")
        yield TruthFrame(
            frame.camera_name,
            frame.stamp_ns,
            camera,
            frame.take("pose"),
            frame.take("photo"),
            surface,
            frame.take("truth_ground"),
            frame.take("truth_labels"),
            np.zeros(surface.shape, np.bool_),
        )
