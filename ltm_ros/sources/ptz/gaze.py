"""From a camera's sections `mount` and `ptz` to how its source knows where it looks."""

from __future__ import annotations

from ltm_core.pose import Pose
from ltm_core.pose_estimation.mount_config import MountConfig
from ltm_core.pose_estimation.mount_model import MountModel
from ltm_core.ptz_config import PtzConfig
from ltm_core.site import Site
from ltm_core.source_config import SourceConfig
from ltm_core.types import Float64Array
from ltm_ros.sources.camera_source import Gaze
from ltm_ros.sources.direction import Reading, Tolerance
from ltm_ros.sources.ptz.head import tolerance_of
from ltm_ros.sources.ptz.head_direction import HeadDirection, HeadPatrol
from ltm_ros.sources.ptz.opening import open_head


class MountPoses:
    """The `PoseModel` of a head on its mount."""

    def __init__(self, model: MountModel, tolerance: Tolerance) -> None:
        self._model = model
        # What a head at rest may still have moved.
        self._moved = (tolerance.angle_deg, tolerance.angle_deg)

    def pose(self, reading: Reading) -> tuple[Pose, Float64Array]:
        return self._model.pose(reading.pan_deg, reading.tilt_deg, self._moved)


def gaze_of_head(site: Site, mount: MountConfig, ptz: PtzConfig | None, source: SourceConfig | None) -> Gaze:
    """Asks the head nothing yet. Without `ptz`, directions come with the pictures. Raises what `MountConfig.model`
    raises."""
    model = mount.model(site.open_dem(), site.frame)
    lens = None if mount.lens is None else mount.lens.lens()
    if ptz is None:
        return Gaze(model=MountPoses(model, Tolerance()), lens=lens)
    tolerance = tolerance_of(ptz)
    direction = HeadDirection(lambda: open_head(ptz, source))
    return Gaze(
        direction=direction,
        model=MountPoses(model, tolerance),
        tolerance=tolerance,
        lens=lens,
        patrol=None if ptz.patrol is None else HeadPatrol(direction, ptz.patrol, tolerance),
    )
