"""Readers of text files: YAML, CSV and JSON."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import yaml
from scenes.networks import write_classifier, write_swapping_head
from scenes.rasters import rough_terrain
from scenes.small_site import write_small_site
from std_msgs.msg import String

from fuzz.mutations import spoil_text
from fuzz.target import Target
from ltm_core.base.resources import config_path
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.fuel.codes import FuelClimate, FuelModels
from ltm_core.fuel.label_errors import stated_errors
from ltm_core.fuel.overlays_io import read_burns
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pose_estimation.mount.mount_config import MountConfig
from ltm_core.pose_estimation.mount.mount_io import read_ptz_points, read_readings
from ltm_core.pose_estimation.points.resection_io import read_control_points, set_up_resection
from ltm_core.raster.dem import Dem
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site_io import load_site
from ltm_core.storage.config_io import load_yaml
from ltm_core.surface.confirmed_surface import SurfaceManifest, SurfaceVersion
from ltm_core.surface.surface_versions_io import MANIFEST, SurfaceVersions
from ltm_core.tracing.trace_io import GuessConfig, load_picture_config, set_up_picture
from ltm_core.vision.areas import read_areas
from ltm_core.vision.label_head import read_label_head
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import NetworkManifest, models_folder
from ltm_core.vision.vocabulary import Vocabulary
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_ros.launching.graph import describe
from ltm_ros.recordings.importing.photo import read_pose_file

_ENTRY = SurfaceVersion(
    version="a" * 16, digest="a" * 64, parent="", as_of_ns=5, cells=20, seen=9, changed=2, lowered=1
)
_SURFACES = SurfaceManifest(site="a", versions=(_ENTRY,)).model_dump_json(indent=1)


def _read_surfaces(path: Path) -> None:
    SurfaceVersions(path.parent, "a", GridGeometry(0.0, 4.0, 1.0, 5, 4)).manifest().at(7)


def _texts(*texts: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: [text.encode() for text in texts]


def _shipped(*names: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: [config_path(name).read_bytes() for name in names]


def _records(folder: Path) -> list[bytes]:
    return [path.read_bytes() for path in sorted((models_folder() / "reliability").glob("*.yaml"))]


def _site(folder: Path) -> list[bytes]:
    content = yaml.safe_load(write_small_site(folder, recording=False).path.read_text())
    content |= {
        "terrain": {"resolution": 10.0},
        "expert": {
            "fuel": {"max_range": 3000.0, "steepest_deg": 45.0},
            "limits": {"pixels": 1_000_000},
            "assumed_pose_error": {"angle_deg": 0.2},
        },
    }
    content["cameras"]["mast"]["mask"] = [{"class": "lens", "polygon": [[0, 0], [40, 0], [0, 30]], "reason": "hood"}]
    return [(folder / "site.yaml").read_bytes(), yaml.safe_dump(content).encode()]


def _read_site(folder: Path) -> None:
    site = load_site(folder / "site.yaml")
    site.fuel_geometry(site.open_dem())
    for name, camera in site.cameras.items():
        site_scene_filter(site, name)
        if camera.calibration is not None:
            camera.calibration.camera()
        if camera.pose is not None:
            camera.pose.pose(site.open_dem(), site.frame)
    describe(site, folder / "site.yaml")


@cache
def _dem() -> Dem:
    return Dem(rough_terrain(7, (60, 80)).elevation, GridGeometry(480_000.0, 4_150_600.0, 10.0, 80, 60, "EPSG:26911"))


def _polygons(folder: Path) -> list[bytes]:
    one = {"image": "a.jpg", "class": "shrub", "polygon": [[10, 140], [250.5, 45], [1000, 45]]}
    return [json.dumps([one, one | {"number": 3, "reason": "hood"}]).encode()]


_PICTURE = """
pose: {x: 480300.0, y: 4150300.0, height_above_ground: 12.5, azimuth_deg: 31.0, pitch_deg: -4.0}
calibration: {width: 64, height: 48, fx: 70.0, fy: 70.0, cx: 31.5, cy: 23.5, k1: 0.1}
"""
_ABOVE = _PICTURE.replace("height_above_ground: 12.5", "z: 900.0, crs: EPSG:4326").replace(
    "x: 480300.0, y: 4150300.0", "x: -117.2, y: 37.5"
)

_MOUNT = """
x: 480300.0
y: 4150300.0
height_above_ground: 12.5
azimuth_deg: 31.0
tilt_zero_deg: 0.3
covariance_deg2: [[0.01, 0, 0, 0], [0, 0.02, 0.001, 0], [0, 0.001, 0.03, 0], [0, 0, 0, 0.04]]
lens: {width: 64, height: 48, zoom: [{zoom: 1, hfov_deg: 60, k1: -0.1}, {zoom: 9, hfov_deg: 20}]}
"""


def _read_mount(path: Path) -> None:
    config = load_yaml(path, MountConfig)
    frame = SiteFrame("EPSG:26911", 480_000.0, 4_150_000.0)
    config.model(_dem().in_frame(frame), frame).pose(20.0, -3.0)
    if config.lens is not None:
        config.lens.lens().camera(config.lens.zoom[0].zoom)


_METADATA_FILE = "recording/metadata.yaml"


def _metadata(folder: Path) -> list[bytes]:
    with BagWriter(folder / "recording") as bag:
        for topic in ("/a/b", "/a/c"):
            bag.write(topic, String(data="x"), 10**18)
    return [(folder / _METADATA_FILE).read_bytes()]


def _yaml(
    name: str, seeds: Callable[[Path], list[bytes]], read: Callable[[Path], object], file: str = "x.yaml"
) -> Target:
    return Target(name, file, seeds, lambda folder: read(folder / file), spoil_text)


def _manifest(folder: Path) -> list[bytes]:
    return [
        write_classifier(folder).read_bytes(),
        *_shipped("models/landscape_lite0_depth.yaml", "models/skyseg_u2netp.yaml")(folder),
    ]


def _head(folder: Path) -> list[bytes]:
    manifest = write_classifier(folder, maps=True)
    return [write_swapping_head(folder / "swap.yaml", manifest).read_bytes()]


TEXT_FILES = (
    Target("site", "site.yaml", _site, _read_site, spoil_text),
    Target("polygons", "polygons.json", _polygons, lambda folder: read_areas(folder / "polygons.json"), spoil_text),
    _yaml("manifest", _manifest, NetworkManifest.load),
    _yaml("head", _head, lambda path: read_label_head(path, NetworkManifest.load(path.with_name("colors.yaml")))),
    _yaml("labels", _shipped("labels.yaml"), LabelSet.load),
    _yaml("fuel_climate", _shipped("fuel/climates/dry.yaml"), lambda path: load_yaml(path, FuelClimate)),
    _yaml("fuel_models", _shipped("fuel/fuel_models.yaml"), lambda path: load_yaml(path, FuelModels)),
    _yaml("label_errors", _records, stated_errors),
    _yaml("fusion", _shipped("models/landscape_lite0_depth_fusion.yaml"), lambda path: load_yaml(path, FusionConfig)),
    _yaml("vocabulary", _shipped("vocabulary.yaml"), lambda path: load_yaml(path, Vocabulary)),
    _yaml("picture", _texts(_PICTURE, _ABOVE), lambda path: set_up_picture(load_picture_config(path), _dem())),
    _yaml("guess", _texts(_PICTURE, _ABOVE), lambda path: set_up_resection(load_yaml(path, GuessConfig), _dem(), None)),
    _yaml(
        "poses_csv",
        _texts(
            "name,camera,x,y,z,azimuth_deg,fx,stamp\n"
            "a.jpg,north,480300.5,4150200.25,900.0,31.0,900,2024-05-06T07:08:09\nb.jpg,,1,2,3,4,5,\n"
        ),
        read_pose_file,
        "poses.csv",
    ),
    _yaml(
        "control_points",
        _texts(
            "id,x,y,z,u,v\na,480100,4150100,900,10.5,20\nb,480200,4150100,910,40,20\n",
            "name,lon,lat,height,col,row\na,-117.2,37.5,900,10,20\n",
        ),
        lambda path: read_control_points(path, SiteFrame("EPSG:26911", 480_000.0, 4_150_000.0)),
        "points.csv",
    ),
    _yaml(
        "head_points",
        _texts(
            "id,x,y,z,u,v,pan_deg,tilt_deg,zoom\na,480100,4150100,900,10.5,20,5,-2,1\nb,480200,4150100,910,40,20,95,1,34\n"
        ),
        lambda path: read_ptz_points(path, SiteFrame("EPSG:26911", 480_000.0, 4_150_000.0)),
        "points.csv",
    ),
    _yaml(
        "readings",
        _texts("name,pan_deg,tilt_deg,zoom\na.jpg,5.25,-2,1\nb.jpg,95,1,34\n"),
        read_readings,
        "readings.csv",
    ),
    _yaml("mount", _texts(_MOUNT), _read_mount, "mount.yaml"),
    _yaml("bag_metadata", _metadata, lambda path: BagReader(path.parent).topic_infos(), _METADATA_FILE),
    _yaml("surfaces", _texts(_SURFACES), _read_surfaces, MANIFEST),
    _yaml(
        "burns",
        _texts(
            '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"burned_at": "2026-08-01"}, '
            '"geometry": {"type": "Polygon", "coordinates": [[[-117.22, 37.49], [-117.21, 37.49], [-117.21, 37.5], '
            "[-117.22, 37.49]]]}}]}"
        ),
        lambda path: read_burns(path, GridGeometry(480_000.0, 4_150_000.0, 30.0, 70, 50, "EPSG:26911")),
        "burns.geojson",
    ),
)  # fmt: skip
