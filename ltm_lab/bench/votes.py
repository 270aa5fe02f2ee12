"""`ltm-lab bench votes`: the time to form the fuel votes of a frame, and the size of their message."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_lab.bench.measure import Cost, least_cost
from ltm_lab.bench.mountains import ridged_terrain

MAST = 60.0
"""Metres of the camera above the ridge that it stands on."""
REACH = 6000.0
"""Metres out to which pixels vote, as a site has it by default."""
_ABOUT = 400
"""Metres about the middle in which the camera's ridge is looked for."""


@dataclass(frozen=True)
class Heading:
    """Where the camera looks: degrees right of grid north, up from the horizon, and its horizontal field of view."""

    name: str
    azimuth_deg: float
    pitch_deg: float
    hfov_deg: float


VIEWS = (
    Heading("wide, to the horizon", 35.0, -6.0, 70.0),
    Heading("tower, zoomed out", 35.0, -10.0, 54.0),
    Heading("zoomed in on a far slope", 35.0, -4.0, 15.0),
    Heading("steep down", 35.0, -35.0, 60.0),
)


@dataclass(frozen=True, eq=False)
class VotesCost:
    """`ground`: share of pixels that see terrain within reach. `votes`: what the frame gave."""

    view: Heading
    cost: Cost
    ground: float
    votes: CellVotes


def run(
    width: int = 1920, height: int = 1080, repeats: int = 15, cell: float = 30.0, extent: int = 5000
) -> list[VotesCost]:
    """Votes of depth images of ridged mountains, `extent` metres a side, under a patchwork of labels, with confidence
    and a pose's covariance, as a node forms them; the kernels are compiled before.
    """
    dem = ridged_terrain(extent)
    middle = extent // 2
    part = slice(middle - _ABOUT, middle + _ABOUT)
    near = dem.elevation[part, part]
    row, col = (int(i) + middle - _ABOUT for i in np.unravel_index(near.argmax(), near.shape))
    x, y = (float(v) for v in dem.geometry.to_map(row, col))
    labels = LabelSet.load()
    grid = GridGeometry(0.0, float(extent), cell, int(extent // cell), int(extent // cell))
    caster = VoteCaster(grid, dem, labels.votes_table[: len(labels)], REACH)
    tracer = TerrainTracer(dem)
    covariance = np.diag([0.25] * 3 + [np.radians(0.3) ** 2] * 3)
    found = []
    for view in VIEWS:
        camera = Camera.from_fov(width, height, view.hfov_deg)
        pose = Pose.from_angles((x, y, float(near.max()) + MAST), view.azimuth_deg, view.pitch_deg)
        traced = tracer.trace(camera, pose)
        depth, (classes, confidence) = traced.depth(), _labelled(height, width, len(labels))

        def cast(
            depth: Float32Array = depth,
            camera: Camera = camera,
            pose: Pose = pose,
            classes: UInt8Array = classes,
            confidence: UInt8Array = confidence,
        ) -> CellVotes:
            return caster.cast(depth, camera, pose, classes, 0, "tower", confidence, covariance)

        votes = cast()
        ground = float((traced.range < REACH).mean())
        found.append(VotesCost(view, least_cost(cast, repeats), ground, votes))
    return found


def _labelled(height: int, width: int, classes: int) -> tuple[UInt8Array, UInt8Array]:
    """Patches of all classes, and their confidence."""
    rng = np.random.default_rng(11)
    step = 24
    coarse = rng.integers(1, classes, (-(-height // step), -(-width // step)), np.uint8)
    fine = coarse.repeat(step, axis=0).repeat(step, axis=1)[:height, :width]
    return np.ascontiguousarray(fine), rng.integers(90, 256, (height, width)).astype(np.uint8)
