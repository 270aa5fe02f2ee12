"""Algorithms of LTM on NumPy arrays: terrain tracing, depth fusion, fuel map, terrain update. They do not depend on
ROS.

The names below are the public ones: `from ltm_core import Dem, Camera, Pose, SiteFrame, TerrainTracer`. Each is loaded
when it is first used, so that a program pays only for what it needs."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ltm_core.base.errors import LtmError
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.depth.topodepth import fuse
    from ltm_core.fuel.class_map import MajorityFuelMap
    from ltm_core.fuel.evidence import EvidenceMap
    from ltm_core.fuel.prior import FuelPrior
    from ltm_core.fuel.votes import VoteCaster
    from ltm_core.geometry.camera import Camera
    from ltm_core.geometry.geodesy import SiteFrame
    from ltm_core.geometry.grid import GridGeometry
    from ltm_core.geometry.pose import Pose
    from ltm_core.geometry.range_image import RangeImage
    from ltm_core.locating.locator import Locator
    from ltm_core.pipeline.site_fuel import site_evidence_map
    from ltm_core.pose_estimation.skyline.find_pose import find_pose
    from ltm_core.raster.dem import Dem
    from ltm_core.site.site import Site
    from ltm_core.site.site_io import load_site
    from ltm_core.surface.surface_map import SurfaceMap
    from ltm_core.tracing.tracer import TerrainTracer
    from ltm_core.visibility.point_visibility import PointVisibility
    from ltm_core.visibility.viewshed import viewshed
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.segmenter import Segmenter

__all__ = [
    "Camera",
    "Dem",
    "DepthNetwork",
    "EvidenceMap",
    "FuelPrior",
    "GridGeometry",
    "LabelSet",
    "Locator",
    "LtmError",
    "MajorityFuelMap",
    "PointVisibility",
    "Pose",
    "RangeImage",
    "Segmenter",
    "Site",
    "SiteFrame",
    "SurfaceMap",
    "TerrainTracer",
    "VoteCaster",
    "find_pose",
    "fuse",
    "load_site",
    "site_evidence_map",
    "viewshed",
]

_MODULES = {
    "Camera": "geometry.camera",
    "Dem": "raster.dem",
    "DepthNetwork": "depth.monocular",
    "EvidenceMap": "fuel.evidence",
    "FuelPrior": "fuel.prior",
    "GridGeometry": "geometry.grid",
    "LabelSet": "vision.labels",
    "Locator": "locating.locator",
    "LtmError": "base.errors",
    "MajorityFuelMap": "fuel.class_map",
    "PointVisibility": "visibility.point_visibility",
    "Pose": "geometry.pose",
    "RangeImage": "geometry.range_image",
    "Segmenter": "vision.segmenter",
    "Site": "site.site",
    "SiteFrame": "geometry.geodesy",
    "SurfaceMap": "surface.surface_map",
    "TerrainTracer": "tracing.tracer",
    "VoteCaster": "fuel.votes",
    "find_pose": "pose_estimation.skyline.find_pose",
    "fuse": "depth.topodepth",
    "load_site": "site.site_io",
    "site_evidence_map": "pipeline.site_fuel",
    "viewshed": "visibility.viewshed",
}


def __getattr__(name: str) -> object:
    """Load a public name when it is first used."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
