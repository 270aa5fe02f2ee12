"""Every converter of messages, fed with messages whose fields hold anything that their types can."""

import contextlib
import os
from array import array
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped, PoseWithCovarianceStamped
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import String

from ltm_core.base.errors import LtmError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.bag.schemas import message_class
from ltm_msgs_py.cells import msg_to_changed
from ltm_msgs_py.grid import msg_to_classes, tile_window
from ltm_msgs_py.image import compressed_size, compressed_to_rgb, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.json_topics import msg_to_model
from ltm_msgs_py.pointcloud import msg_to_columns, msg_to_votes
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.fuel_map.services import region_of

FRESH = bool(os.environ.get("LTM_FUZZ"))
"""In `make fuzz`: new examples each time, and many; else the same ones."""
GRID = GridGeometry(10.0, 400.0, 30.0, 14, 9)
_WORDS = [
    "", "map", "x", "y", "z", "row", "rgb8", "mono8", "mono16", "32FC1", "16UC1", "plumb_bob", "jpeg", "grass",
    "{}",
]  # fmt: skip
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"


def _numbers(kind: str) -> st.SearchStrategy[Any]:
    if kind in ("float", "double"):
        width = 32 if kind == "float" else 64
        return st.one_of(st.sampled_from([0.0, 1.0, -1.0]), st.floats(width=width))
    if kind == "boolean":
        return st.booleans()
    if kind in ("byte", "octet"):
        return st.binary(min_size=1, max_size=1)
    bits = int("".join(c for c in kind if c.isdigit()))
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return st.one_of(st.integers(0, min(high, 12)), st.sampled_from([low, high]), st.integers(low, high))


def _values(kind: str) -> st.SearchStrategy[Any]:
    """What a field of that type can hold; sequences of up to 200."""
    if kind.startswith("sequence<"):
        inner = kind[len("sequence<") :].rstrip(">").split(",")[0]
        if inner in ("uint8", "int8"):
            parts = st.tuples(st.sampled_from([b"", _JPEG, _PNG]), st.binary(max_size=200)).map(b"".join)
            return parts.map(lambda data: array("B" if inner == "uint8" else "b", data))
        return st.lists(_values(inner), max_size=6)
    if "[" in kind:
        inner, size = kind.rstrip("]").split("[")
        return st.lists(_values(inner), min_size=int(size), max_size=int(size))
    if kind == "string":
        return st.one_of(st.sampled_from(_WORDS), st.text(st.characters(exclude_categories=["Cs"]), max_size=40))
    return messages(message_class(kind.replace("/", "/msg/"))) if "/" in kind else _numbers(kind)


def messages(kind: Any) -> st.SearchStrategy[Any]:
    """Messages of a type."""
    fields = kind.get_fields_and_field_types()
    return st.builds(kind, **{name: _values(of) for name, of in fields.items()})


def _covariance(message: Any) -> None:
    msg_to_covariance(message)


CONVERTERS: list[tuple[Any, Callable[[Any], object]]] = [
    (CameraInfo, msg_to_camera), (CameraInfo, stamp_of), (PoseStamped, msg_to_pose),
    (PoseWithCovarianceStamped, msg_to_pose), (PoseWithCovarianceStamped, _covariance), (Image, msg_to_array),
    (Image, msg_to_rgb), (Image, msg_to_depth), (CompressedImage, compressed_size),
    (CompressedImage, compressed_to_rgb), (OccupancyGrid, msg_to_classes),
    (OccupancyGrid, lambda message: tile_window(msg_to_classes(message)[1], GRID)), (PointCloud2, msg_to_columns),
    (PointCloud2, msg_to_changed),
    (PointCloud2, lambda message: msg_to_votes(message, GRID, LabelSet.load().names, "north")),
    (PolygonStamped, lambda message: region_of(message, GRID)), (String, msg_to_model),
    (DiagnosticArray, stamp_of),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    ("kind", "convert"), CONVERTERS, ids=[f"{k.__name__}-{c.__name__.strip('<>')}" for k, c in CONVERTERS]
)
@settings(
    max_examples=3000 if FRESH else 15,
    derandomize=not FRESH,
    deadline=None,
    print_blob=FRESH,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(data=st.data())
def test_no_error_but_ours(kind: Any, convert: Callable[[Any], object], data: st.DataObject) -> None:
    message = data.draw(messages(kind))
    with contextlib.suppress(LtmError):
        convert(message)
