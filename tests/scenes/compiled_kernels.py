"""Kernels, compiled once for all processes of a test run: the nodes', and those that many tests use besides.

Numba keeps what it has compiled in a folder that all processes share, but two that need a kernel at the same time both
compile it: cold, every node of a graph and every worker would spend a minute or two on the same.
"""

import fcntl
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from ltm_core.depth.expected_surface import FusionSettings
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.topodepth import fuse
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.kernels import KERNELS
from ltm_core.pipeline.kernels import compile_kernels as compile_kernels_of
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import find_pose
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack
from ltm_core.site.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import PosedCamera, viewshed
from ltm_core.vision.labels import LabelSet
from ltm_lab.bench.mountains import ridged_terrain
from ltm_lab.simulator.run import make_site, rasters_at
from ltm_lab.tracers.march import march
from ltm_lab.training.fusion_samples import frame_samples
from scenes import mountain_view
from scenes.depth_scene import depth_scene
from scenes.rasters import rough_terrain, standing
from scenes.small_scenario import small_scenario
from scenes.terrain_frames import write_fusing_site


def _poses(_: str) -> None:
    pose = Pose.from_angles(mountain_view.eye(), 63.0, 2.5, 1.2)
    evidence = picture_evidence(*mountain_view.view(pose), mountain_view.CAMERA)
    find_pose(evidence, mountain_view.terrain(), PosePrior(pose, 1.5, 0.5, 0.5))


def _simulator(_: str) -> None:
    scenario = small_scenario()
    rasters_at(scenario, make_site(scenario))
    ridged_terrain(40)


def _rays(_: str) -> None:
    """Of rays in any direction over whole ground, over ground with holes, over ground with a margin that is not known
    and over a stack of two rasters, without and with a lens's distortion; what a place sees; and the paper's march."""
    whole = rough_terrain(5, (70, 90))
    holed = whole.elevation.copy()
    holed[30:40, 50:60] = np.nan
    rimmed = holed.copy()
    rimmed[:7] = np.nan
    camera = Camera(40, 30, 40.0, 40.0, 19.5, 14.5, (0.1, 0.0, 0.0, 0.0, 0.0))
    pose = Pose.from_angles(standing(whole, 40.0, 30.0, 25.0), 80.0, -15.0, 5.0)
    stack = DemStack([Dem(holed, whole.geometry), rough_terrain(6, (90, 110), resolution=30.0)])
    for dem in (whole, Dem(holed, whole.geometry), Dem(rimmed, whole.geometry), stack):
        for tracer in (TerrainTracer(dem), TerrainTracer(dem, possible=NOTHING_BEYOND)):
            tracer.trace(camera, pose)
            tracer.trace_rays(pose.position, camera.rays().reshape(-1, 3) @ pose.rotation.T)
        viewshed(PointVisibility(dem), [PosedCamera("one", camera, pose)])
        march(dem, pose.position, [(0.6, 0.0, -0.8)])


def _fusion_of_a_photo(_: str) -> None:
    scene, classes = depth_scene(), ClassPriors.of(LabelSet.load())
    fuse(scene.traced, scene.network(), scene.photo, scene.labels, classes)


def _samples(_: str) -> None:
    """Compile the samples that fusion is fitted to."""
    scene, step = depth_scene(), 2
    true = scene.truth[::step, ::step].astype(np.float32)
    frame = scene.traced, scene.network(), scene.photo, scene.labels, true, None
    frame_samples(*frame, LabelSet.load(), FusionSettings(), FusionConfig())


NODES: dict[str, Callable[[str], None]] = {
    kind: lambda site, kind=kind: compile_kernels_of(kind, load_site(site)) for kind in KERNELS
}
"""Each kind of node, compiled by one process, from a site file; the largest first."""
ALL = NODES | {
    "simulator": _simulator,
    "poses": _poses,
    "rays": _rays,
    "fusion of a photo": _fusion_of_a_photo,
    "samples": _samples,
}


def compile_kernels(parts: Mapping[str, Callable[[str], None]] = NODES) -> None:
    """Returns once all are compiled, by this process or by others that do the same now."""
    cache = os.environ.get("NUMBA_CACHE_DIR")
    if cache is None or os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return
    folder = Path(cache)
    # First what nobody is at, then wait for what others are at.
    for wait in (0, 1):
        for name, compile_part in parts.items():
            with (folder / f"{name}.lock").open("w") as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
                except BlockingIOError:
                    continue
                done = folder / f"{name}.compiled"
                if not done.exists():
                    with tempfile.TemporaryDirectory() as site:
                        compile_part(str(write_fusing_site(Path(site), recording=False).path))
                    done.touch()


if __name__ == "__main__":
    compile_kernels(ALL)
