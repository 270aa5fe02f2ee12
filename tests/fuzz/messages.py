"""Converters and handlers of the graph's messages: fields are set to what they can hold and nobody means.

A case is a script in JSON: which of a handler's topics get a message, and the serialised messages. So a script is a
file like any other, and can be kept and repeated.
"""

import base64
import json
import random
import re
from array import array
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rclpy.serialization import deserialize_message, serialize_message
from scenes.networks import write_depth_network
from scenes.outlets import Kept
from scenes.small_site import BEGIN_NS, NAME, SmallSite, write_small_site
from scenes.terrain_frames import measured_messages, write_terrain_site
from sensor_msgs.msg import Imu, NavSatFix

from fuzz.mutations import spoil_bytes
from fuzz.target import Target
from ltm_core.base.errors import LtmError
from ltm_core.fuel.votes import VoteCaster
from ltm_core.surface.change import Changed
from ltm_core.surface.confirmed_surface import AS_GIVEN, SurfaceManifest
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.cells import changed_to_msg, manifest_to_msg, traced_to_msg
from ltm_msgs_py.grid import classes_to_msg
from ltm_msgs_py.image import compressed_to_msg, depth_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.json_topics import label_set_to_msg
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.capture import CaptureConfig, CaptureHandler
from ltm_ros.nodes.depth import DepthConfig, DepthHandler
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.nodes.fuel_votes import FuelVotesHandler
from ltm_ros.nodes.locate import LocateConfig, LocateHandler
from ltm_ros.nodes.segmentation import SegmentationConfig, SegmentationHandler
from ltm_ros.nodes.terrain import TerrainHandler, TerrainNodeConfig
from ltm_ros.nodes.topodepth import TopoDepthConfig, TopoDepthHandler
from ltm_ros.nodes.viewer import ViewerConfig, ViewerHandler
from ltm_ros.runtime.handler import Handler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.stamp_join import JoinConfig
from ltm_ros.runtime.topics import TERRAIN_SURFACE

_FLOATS = (
    0.0, -0.0, 1.0, -1.0, 1e-320, 1e-30, 1e6, 1e15, 1e30, 1e300, -1e300, float("inf"), float("-inf"), float("nan"),
    90.0,
)  # fmt: skip
_TEXTS = (
    "", "map", "nan", "x" * 5000, "../../x", "é", "\U0001f525", "rgb8", "mono8", "mono16", "32FC1", "16UC1",
    "32FC3", "bayer_rggb8", "plumb_bob", "jpeg", "{}", "[" * 3000, '{"unlabelled": 255, "labels": []}',
)  # fmt: skip


def spoil_message(rng: random.Random, message: Any) -> None:
    """Set one field of a message, or of one within it, to something hostile."""
    kinds = message.get_fields_and_field_types()
    name = rng.choice(list(kinds))
    kind, value = kinds[name], getattr(message, name)
    if hasattr(value, "get_fields_and_field_types"):
        spoil_message(rng, value)
    elif kind.startswith("sequence<") and value and hasattr(value[0], "get_fields_and_field_types"):
        way = rng.random()
        if way < 0.7:
            spoil_message(rng, rng.choice(value))
        else:
            setattr(
                message,
                name,
                list(value) * rng.choice((0, 2, 300)) if way < 0.9 else value[: rng.randrange(len(value))],
            )
    elif isinstance(value, (array, np.ndarray, list, tuple)) or "[" in kind or kind.startswith("sequence<"):
        _spoil_numbers(rng, message, name, kind, value)
    elif isinstance(value, bool):
        setattr(message, name, not value)
    elif isinstance(value, bytes):
        setattr(message, name, bytes([rng.randrange(256)]))
    elif isinstance(value, int):
        signed, bits = not kind.startswith("u"), int(re.sub(r"\D", "", kind))
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        choices = (low, high, 0, 1, value + 1, value - 1, value * 2, value // 2, 100_000, rng.randint(low, high))
        setattr(message, name, min(max(rng.choice(choices), low), high))
    elif isinstance(value, float):
        most = 3e38 if kind == "float" else 1.7e308
        number = rng.choice((*_FLOATS, value * (1 + 1e-7), value * 1e4, -value))
        setattr(message, name, number if not np.isfinite(number) else min(max(number, -most), most))
    elif isinstance(value, str):
        setattr(message, name, rng.choice(_TEXTS) if rng.random() < 0.8 else value + rng.choice(_TEXTS))


def _spoil_numbers(rng: random.Random, message: Any, name: str, kind: str, value: Any) -> None:
    if isinstance(value, array) and value.typecode in "Bb":  # the bytes of images and clouds
        data = spoil_bytes(rng, value.tobytes(), [value.tobytes()])
        setattr(message, name, array(value.typecode, data))
    elif len(value):
        numbers = list(value)
        for _ in range(rng.choice((1, 1, 2, len(numbers)))):
            numbers[rng.randrange(len(numbers))] = rng.choice(_FLOATS)
        if kind.startswith("sequence<"):
            numbers = numbers * rng.choice((1, 1, 2)) + [0.0] * rng.choice((0, 0, 1, 1000))
        setattr(message, name, numbers)
    elif kind == "sequence<double>":
        setattr(message, name, [rng.choice(_FLOATS) for _ in range(rng.choice((1, 4, 5, 8)))])


@dataclass(frozen=True)
class Play:
    """A handler that is fed. `messages`: whole ones, by topic name, in their order; `make`: the handler anew."""

    name: str
    prepare: Callable[[Path], tuple[Callable[[], Handler[Any]], list[tuple[str, Any]]]]

    def target(self) -> Target:
        return Target(f"node_{self.name}", "script.json", self.seeds, self.read, self.spoil)

    def seeds(self, folder: Path) -> list[bytes]:
        return [_script(_prepared(self, folder)[1])]

    def read(self, folder: Path) -> None:
        make, _ = _prepared(self, folder)
        handler = make()
        takes: Mapping[str, Any] = {topic.name: (topic.type, take) for topic, take in handler.subscriptions.items()}
        refused: list[LtmError] = []
        for name, content in json.loads((folder / "script.json").read_bytes()):
            kind, take = takes[name]
            try:
                message = deserialize_message(base64.b64decode(content), kind)
            except Exception:  # what the binding raises: such bytes never reach a handler
                continue
            try:
                take(message)
                handler.idle()
            except LtmError as error:
                refused.append(error)
        for step in (lambda: handler.tick(60.0), handler.finish):
            try:
                step()
            except LtmError as error:
                refused.append(error)
        if refused:
            raise refused[-1]

    def spoil(self, rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
        types = _TYPES[self.name]
        messages = [
            (name, deserialize_message(base64.b64decode(content), types[name])) for name, content in json.loads(data)
        ]
        for _ in range(rng.choice((1, 1, 1, 2, 4))):
            spoil_message(rng, rng.choice(messages)[1])
        if rng.random() < 0.2:
            rng.shuffle(messages)
        if rng.random() < 0.2:
            messages += rng.choices(messages, k=rng.choice((1, 3)))
        script = json.loads(_script(messages))
        if rng.random() < 0.15:
            at = rng.randrange(len(script))
            cdr = base64.b64decode(script[at][1])
            script[at][1] = base64.b64encode(spoil_bytes(rng, cdr, [cdr])).decode()
        return json.dumps(script).encode()


_TYPES: dict[str, dict[str, type]] = {}


@cache
def _prepared(play: Play, folder: Path) -> tuple[Callable[[], Handler[Any]], list[tuple[str, Any]]]:
    make, messages = play.prepare(folder)
    _TYPES[play.name] = {topic.name: topic.type for topic in make().subscriptions}
    return make, messages


def _script(messages: list[tuple[str, Any]]) -> bytes:
    return json.dumps([(name, base64.b64encode(serialize_message(m)).decode()) for name, m in messages]).encode()


def _outlet(*wants: Any) -> Kept:
    outlet = Kept(*wants)
    outlet.now = BEGIN_NS + 5 * 10**9
    return outlet


def _small(folder: Path) -> SmallSite:
    return write_small_site(folder, recording=False)


def _frame(small: SmallSite, stamp: int = BEGIN_NS) -> dict[str, Any]:
    """A frame of the tower at a tenth of its size, message by message."""
    from ltm_core.geometry.camera import Camera

    camera, pose = Camera.from_fov(48, 32, 62.0), small.tower_pose(20.0)
    traced = small.tracer.trace(camera, pose).depth()
    photo = np.random.default_rng(2).integers(0, 255, (32, 48, 3), np.uint8)
    labels = np.where(np.isfinite(traced), np.uint8(1), np.uint8(0))
    lon, lat = (float(v) for v in small.site.frame.to_lonlat(pose.position[0], pose.position[1]))
    fix = NavSatFix(
        header=make_header(stamp, "gps"), latitude=lat, longitude=lon, altitude=float(pose.position[2]) - 35
    )
    fix.position_covariance, fix.position_covariance_type = np.eye(3).ravel(), 2
    imu = Imu(header=make_header(stamp, "phone"), orientation_covariance=np.diag([0.01] * 3).ravel())
    return {
        "fix": fix,
        "imu": imu,
        "info": camera_to_msg(camera, stamp, "tower_optical"),
        "pose": pose_to_msg(pose, stamp, "map", np.diag([0.1, 0.2, 0.3, 1e-5, 2e-5, 3e-5])),
        "jpeg": compressed_to_msg(encode_rgb(photo), "jpeg", stamp, "tower_optical"),
        "photo": image_to_msg(photo, "rgb8", stamp, "tower_optical"),
        "depth": depth_to_msg(traced, stamp, "tower_optical"),
        "labels": image_to_msg(labels, "mono8", stamp, "tower_optical"),
        "confidence": image_to_msg(np.full(labels.shape, 200, np.uint8), "mono8", stamp, "tower_optical"),
        "traced": traced_to_msg("tower", stamp, AS_GIVEN),
        "surface": manifest_to_msg(SurfaceManifest(site=NAME)),
        "votes": votes_to_msg(_votes(small, traced, camera, pose, labels, stamp), LabelSet.load().names),
    }


def _votes(small: SmallSite, traced: Any, camera: Any, pose: Any, labels: Any, stamp: int) -> Any:
    names = LabelSet.load()
    caster = VoteCaster(small.site.fuel_geometry(small.dem), small.dem, names.votes_table[: len(names)])
    return caster.cast(traced, camera, pose, labels, stamp, "tower", np.full(labels.shape, 200, np.uint8))


def _play(make: Callable[[SmallSite, Path], Handler[Any]], topics: Mapping[str, str]) -> Any:
    """Of a node of the tower: `topics`: the frame's part by topic."""

    def prepare(folder: Path) -> tuple[Callable[[], Handler[Any]], list[tuple[str, Any]]]:
        small = _small(folder)
        write_depth_network(folder)
        parts = _frame(small)
        return lambda: make(small, folder), [(topic, parts[part]) for topic, part in topics.items()]

    return prepare


def _kept(make: Callable[[SmallSite, Path], Handler[Any]]) -> Callable[[SmallSite, Path], Handler[Any]]:
    """For handlers that cost seconds to make: made once a process. Their joins then hold what cases before left."""
    made: list[Handler[Any]] = []

    def once(small: SmallSite, folder: Path) -> Handler[Any]:
        if not made:
            made.append(make(small, folder))
        return made[0]

    return once


def _capture(small: SmallSite, folder: Path) -> Handler[Any]:
    return CaptureHandler(CaptureConfig(site=str(small.path), camera="tower"), _outlet(), Health())


def _capture_sensors(small: SmallSite, folder: Path) -> Handler[Any]:
    document = yaml.safe_load(small.path.read_text())
    document["cameras"]["tower"]["sensors"] = {}
    document["expert"] = {"cameras": {"tower": {"sensors": {"geoid_undulation": -35.0}}}}
    path = small.path.with_name("sensors.yaml")
    path.write_text(yaml.safe_dump(document))
    return CaptureHandler(CaptureConfig(site=str(path), camera="tower"), _outlet(), Health())


def _depth(small: SmallSite, folder: Path) -> Handler[Any]:
    config = DepthConfig(site=str(small.path), camera="tower", surfaces=str(folder / "surfaces"))
    return DepthHandler(config, _outlet(), Health())


def _fuel_votes(small: SmallSite, folder: Path) -> Handler[Any]:
    return FuelVotesHandler(JoinConfig(site=str(small.path), camera="tower"), _outlet(), Health())


def _segmentation(small: SmallSite, folder: Path) -> Handler[Any]:
    return SegmentationHandler(SegmentationConfig(site=str(small.path), camera="tower"), _outlet(), Health())


def _topodepth(small: SmallSite, folder: Path) -> Handler[Any]:
    config = TopoDepthConfig(
        site=str(small.path), camera="tower", model=str(folder / "depth.yaml"), surfaces=str(folder / "surfaces")
    )
    return TopoDepthHandler(config, _outlet(), Health())


_FUSED = {
    "posed/image": "photo", "posed/camera_info": "info", "posed/pose": "pose",
    "depth/image": "depth", "depth/info": "traced", "labels/image": "labels",
}  # fmt: skip


def _fuel_map(folder: Path) -> tuple[Callable[[], Handler[Any]], list[tuple[str, Any]]]:
    from geometry_msgs.msg import Point32, PointStamped, PolygonStamped

    small = _small(folder)
    small.path.write_text(small.path.read_text() + yaml.safe_dump({"terrain": {"resolution": 10.0}}))
    parts = _frame(small)
    query = PointStamped(header=parts["pose"].header)
    query.point.x, query.point.y = 500.0, 400.0
    region = PolygonStamped(header=parts["pose"].header)
    region.polygon.points = [Point32(x=x, y=y) for x, y in ((200.0, 200.0), (700.0, 250.0), (400.0, 600.0))]
    config = FuelMapConfig(site=str(small.path), allow_burn=True, max_behind=1e9)
    messages = [
        (f"/{NAME}/tower/fuel/votes", parts["votes"]),
        (f"/{NAME}/tower/labels/info", label_set_to_msg(LabelSet.load(), "a network")),
        ("fuel_map/query", query),
        ("fuel_map/region", region),
        *[(topic, message) for topic, message in _terrain_news(small)],
    ]

    class Served(FuelMapHandler):
        """Its service is called too, whatever region there is."""

        def finish(self) -> None:
            with suppress(LtmError):
                self.burn()
            super().finish()

    return lambda: Served(config, _outlet(), Health()), messages


def _terrain_news(small: SmallSite) -> list[tuple[str, Any]]:
    geometry = small.dem.geometry
    rows, cols = np.arange(8, dtype=np.int32) + 3, np.arange(8, dtype=np.int32) + 40
    kinds = np.ones(8, np.uint8)
    changed = Changed(rows, cols, np.zeros_like(kinds), kinds, np.full(8, -4.0, np.float32))
    classes = np.zeros((12, 9), np.uint8)
    update = changed_to_msg(changed, np.full(8, 900.0, np.float32), geometry, BEGIN_NS)
    return [
        ("terrain/update", update),
        ("terrain/change", classes_to_msg(classes, geometry.window(4, 5, 12, 9), BEGIN_NS)),
    ]


def _terrain(folder: Path) -> tuple[Callable[[], Handler[Any]], list[tuple[str, Any]]]:
    small = write_terrain_site(folder)
    config = TerrainNodeConfig(site=str(small.path), depth_from_elsewhere=True)
    parts = measured_messages(small, small.dem, BEGIN_NS)
    messages = [(f"/{NAME}/mast/{topic.name}", message) for topic, message in parts.items()]
    return lambda: TerrainHandler(config, _outlet(), Health()), messages


def _locate(folder: Path) -> tuple[Callable[[], Handler[Any]], list[tuple[str, Any]]]:
    from geometry_msgs.msg import Point32, PointStamped, PolygonStamped

    small = _small(folder)
    small.path.write_text(small.path.read_text() + yaml.safe_dump({"locating": {}}))
    parts = _frame(small)
    region, point = PolygonStamped(header=parts["info"].header), PointStamped(header=parts["info"].header)
    region.polygon.points = [Point32(x=x, y=y) for x, y in ((20.0, 14.0), (26.0, 14.0), (25.0, 24.0), (21.0, 23.0))]
    point.point.x, point.point.y = 24.0, 25.0
    messages = [
        (f"/{NAME}/tower/posed/camera_info", parts["info"]),
        (f"/{NAME}/tower/posed/pose", parts["pose"]),
        (f"/{NAME}/tower/locate/region", region),
        (f"/{NAME}/tower/locate/point", point),
    ]
    return lambda: LocateHandler(LocateConfig(site=str(small.path), max_behind=1e9), _outlet(), Health()), messages


def _viewer(folder: Path) -> tuple[Callable[[], Handler[Any]], list[tuple[str, Any]]]:
    small = _small(folder)
    small.path.write_text(small.path.read_text() + yaml.safe_dump({"terrain": {"resolution": 10.0}}))
    parts = _frame(small)
    grid = small.site.fuel_geometry(small.dem)
    camera = {
        "posed/image": "photo",
        "depth/image": "depth",
        "depth/camera_info": "info",
        "labels/image": "labels",
        "posed/pose": "pose",
    }
    messages = [(f"/{NAME}/tower/{topic}", parts[part]) for topic, part in camera.items()]
    messages.append((f"/{NAME}/fuel_map", classes_to_msg(np.ones(grid.shape, np.uint8), grid, BEGIN_NS)))
    messages += [(f"/{NAME}/{topic}", message) for topic, message in _terrain_news(small)]
    return lambda: ViewerHandler(ViewerConfig(site=str(small.path)), _outlet(), Health()), messages


MESSAGES = (
    Play("capture", _play(_capture, {"camera_info": "info", "pose": "pose", "image_raw/compressed": "jpeg"})).target(),
    Play(
        "capture_sensors",
        _play(_capture_sensors, {"camera_info": "info", "fix": "fix", "imu": "imu", "image_raw/compressed": "jpeg"}),
    ).target(),
    Play(
        "depth",
        _play(
            _depth, {"posed/camera_info": "info", "posed/pose": "pose", f"/{NAME}/{TERRAIN_SURFACE.name}": "surface"}
        ),
    ).target(),
    Play(
        "fuel_votes",
        _play(
            _fuel_votes,
            {
                "depth/image": "depth",
                "depth/camera_info": "info",
                "labels/image": "labels",
                "labels/confidence": "confidence",
                "posed/pose": "pose",
            },
        ),
    ).target(),
    Play(
        "segmentation",
        _play(_kept(_segmentation), {"posed/image": "photo", "posed/camera_info": "info", "posed/pose": "pose"}),
    ).target(),
    Play("topodepth", _play(_topodepth, _FUSED)).target(),
    Play("fuel_map", _fuel_map).target(),
    Play("terrain", _terrain).target(),
    Play("locate", _locate).target(),
    Play("viewer", _viewer).target(),
)
