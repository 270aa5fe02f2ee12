"""Compile the kernels of each kind of node on small scenes, before its first frame needs them."""

from collections.abc import Callable
from typing import Final

import numpy as np

from ltm_core.base.resources import config_path
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.site.site import Site


def _fusion(site: Site) -> None:
    from ltm_core.depth.fusion_config import FusionConfig
    from ltm_core.depth.ground_sampling import ClassPriors
    from ltm_core.depth.monocular import NetworkDepth
    from ltm_core.depth.topodepth import fuse
    from ltm_core.geometry.range_image import DepthImage
    from ltm_core.vision.labels import LabelSet

    camera = Camera.from_fov(96, 64, 50.0)
    rows, cols = np.mgrid[0:64, 0:96]
    depth = (3000.0 / (4 + rows) + 0.1 * cols).astype(np.float32)
    depth[:10] = np.inf
    traced = DepthImage(depth, camera, Pose.from_angles((0.0, 0.0, 0.0), 0.0))
    rgb, labels = np.zeros((64, 96, 3), np.uint8), np.ones((64, 96), np.uint8)
    network = NetworkDepth((1 / np.minimum(depth, 1e4)).astype(np.float32), "relative_inverse")
    config = FusionConfig()
    classes = ClassPriors.of(LabelSet.load(config_path(site.labels)), config)
    for given in (labels, None):
        fuse(traced, network, rgb, given, classes, config=config).measured()


def _tracing(_: Site) -> None:
    from ltm_core.raster.dem import Dem
    from ltm_core.tracing import TerrainTracer

    heights = np.zeros((9, 12), np.float32)
    heights[0, 0] = np.nan  # a hole
    plain = Dem(heights, GridGeometry(0.0, 9.0, 1.0, 12, 9))
    pose = Pose.from_angles((6.3, 4.4, 10.0), 0.0, -20.0)
    for way in ("profile", "pyramid"):
        TerrainTracer(plain).trace(Camera.from_fov(3, 2, 50.0), pose, way)


def _terrain(site: Site) -> None:
    """Compile with two observations of a subsided plain, which exercise everything up to a change."""
    from ltm_core.raster.dem import Dem
    from ltm_core.surface.config import TerrainConfig
    from ltm_core.surface.observation import DepthFrame
    from ltm_core.surface.reference_surface import Reference
    from ltm_core.surface.surface_map import SurfaceMap
    from ltm_core.tracing import TerrainTracer

    plain = Dem(np.zeros((64, 64), np.float32), GridGeometry(0.0, 64.0, 1.0, 64, 64))
    camera, pose = Camera.from_fov(64, 48, 50.0), Pose.from_angles((32.0, 5.0, 30.0), 0.0, -45.0)
    sunk = TerrainTracer(Dem(plain.elevation - 10, plain.geometry)).trace(camera, pose).depth()
    sure, seen = np.full(sunk.shape, 0.1, np.float32), np.ones(sunk.shape, np.bool_)
    covariance = np.diag([1e-4] * 3 + [1e-5] * 3)
    told, gone = (np.ones(sunk.shape, np.uint8), camera), np.ones(256, np.float32)
    for stable in (None, seen):
        small = (site.terrain or TerrainConfig()).model_copy(update={"cache_mb": 32.0})
        tiny = SurfaceMap(Reference.of(plain), small, ("any",), gone=gone)
        for stamp in (0, 7_200_000_000_000):
            tiny.add(DepthFrame(sunk, sure, seen, camera, pose, stamp, "any", covariance, None, stable, told))
        tiny.decide()


def _votes(site: Site) -> None:
    from ltm_core.fuel.votes import VoteCaster
    from ltm_core.pipeline.pose_watch import contradicted_share
    from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
    from ltm_core.raster.dem import Dem
    from ltm_core.vision.labels import Label, LabelSet

    flat = Dem(np.zeros((9, 9), np.float32), GridGeometry(-400.0, 500.0, 100.0, 9, 9))
    camera, pose = Camera.from_fov(64, 48, 60.0), Pose.from_angles((0.0, 0.0, 10.0), 0.0, 0.0)
    labels = np.full((48, 64), Label.GRASS, np.uint8)
    labels[:24] = Label.SKY
    classes = LabelSet.load(config_path(site.labels))
    nothing = np.full(labels.shape, np.nan, np.float32)
    caster = VoteCaster(flat.geometry, flat, classes.votes_table[: len(classes)], site.fuel.max_range, site.bend, None)
    caster.cast(nothing, camera, pose, labels, 0, "any", labels, None)
    contradicted_share(labels, camera, pose, SearchTerrain(flat, 0.0))


def _fuel_map(site: Site) -> None:
    """Compile the kernels of evidence for the label errors of the site and of its cameras."""
    from ltm_core.fuel.evidence import EvidenceMap
    from ltm_core.fuel.votes import CellVisibility, CellVotes
    from ltm_core.site.networks import camera_label_errors, site_label_errors
    from ltm_core.vision.labels import LabelSet

    labels = LabelSet.load(config_path(site.labels))
    one = np.ones(1, np.float32)
    cell, counts = np.zeros(1, np.int32), np.ones((1, len(labels)), np.uint32)
    tiny = GridGeometry(0.0, 60.0, 30.0, 3, 2)
    votes = CellVotes(tiny, cell, cell, counts, one, 0, "", one, CellVisibility(*([100 * one] * 5)))
    for errors in (site_label_errors(site), *camera_label_errors(site).values()):
        counted = EvidenceMap(tiny, None, labels, errors=errors)
        counted.add(votes)
        counted.layers()


def _labels(_: Site) -> None:
    from ltm_core.pipeline.frame_steps import UnlikelyLabels
    from ltm_core.raster.dem import Dem
    from ltm_core.tracing import TerrainTracer
    from ltm_core.vision.resampling import reduced_by_area, upsampled_winner

    plain = Dem(np.zeros((9, 12), np.float32), GridGeometry(0.0, 9.0, 1.0, 12, 9))
    pose = Pose.from_angles((6.3, 4.4, 10.0), 0.0, -20.0)
    UnlikelyLabels(TerrainTracer(plain)).of(Camera.from_fov(3, 2, 50.0), pose, None)
    reduced_by_area(np.zeros((4, 5, 3), np.uint8), 2, 2)
    upsampled_winner(np.full((3, 5, 7), 1 / 3, np.float32), 40, 60)


def _locating(_: Site) -> None:
    from ltm_core.locating.answer import place_views
    from ltm_core.locating.locator import Locator
    from ltm_core.locating.region import marked_pixel
    from ltm_core.locating.sighting import Sighting
    from ltm_core.raster.dem import Dem
    from ltm_core.visibility.point_visibility import PointVisibility
    from ltm_core.visibility.viewshed import PosedCamera

    plain = Dem(np.zeros((60, 80), np.float32), GridGeometry(0.0, 600.0, 10.0, 80, 60))
    camera, pose = Camera.from_fov(64, 48, 50.0), Pose.from_angles((400.0, 50.0, 40.0), 0.0, -10.0)
    mark = marked_pixel(camera, (32.0, 24.0), 1.0)
    covariance = np.diag([0.1] * 3 + [1e-5] * 3)
    beside = Pose.from_angles((200.0, 50.0, 40.0), 40.0, -10.0)
    one, other = (Sighting(name, camera, at, covariance, mark) for name, at in (("one", pose), ("other", beside)))
    for smoke in (False, True):
        Locator(plain, 0.0).locate([one, other], smoke)  # of two cameras, each may be turned
    place_views(PointVisibility(plain), [PosedCamera("one", camera, pose)], np.array([400.0, 300.0, 0.0]))


KERNELS: Final[dict[str, Callable[[Site], None]]] = {
    "topodepth": _fusion,
    "depth": _tracing,
    "fuel_map": _fuel_map,
    "fuel_votes": _votes,
    "terrain": _terrain,
    "locate": _locating,
    "segmentation": _labels,
}
"""By kind of node; those that take longest first."""


def compile_kernels(kind: str, site: Site) -> None:
    """Compile the kernels of a kind of node, or load them from numba's cache."""
    KERNELS[kind](site)
