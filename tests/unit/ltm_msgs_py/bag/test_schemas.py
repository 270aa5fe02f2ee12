import sys

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.schemas import message_class, schema_text, type_hash

TYPES = [
    "std_msgs/msg/String",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/PointCloud2",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/OccupancyGrid",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rosgraph_msgs/msg/Clock",
    "visualization_msgs/msg/MarkerArray",
]


def test_definitions_and_hashes_are_those_of_rosbags() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for type_name in TYPES:
        for name, (_, fields) in get_types_from_msg(schema_text(type_name), type_name).items():
            assert fields == store.fielddefs[name][1], name
        assert type_hash(type_name) == store.hash_rihs01(type_name)


@pytest.mark.parametrize(
    "name", ["", "Image", "sensor_msgs/Image", "sensor_msgs/srv/SetCameraInfo", "../msg/Image", "a.b/msg/C", "os/msg/c"]
)
def test_names_of_another_form_are_refused(name: str) -> None:
    with pytest.raises(RecordingError, match="package/msg/Message"):
        message_class(name)


@pytest.mark.parametrize("name", ["acme_msgs/msg/Rocket", "sensor_msgs/msg/Rocket"])
def test_types_that_are_not_installed_are_named_with_their_package(name: str) -> None:
    with pytest.raises(RecordingError, match=f"{name} is not installed.*{name.split('/')[0].replace('_', '-')}"):
        message_class(name)
    with pytest.raises(RecordingError, match=f"no definition of message type {name}"):
        schema_text(name)


def test_a_bag_cannot_make_us_import_any_module_it_names() -> None:
    sys.modules.pop("antigravity", None)
    with pytest.raises(RecordingError, match="not installed"):
        message_class("antigravity/msg/Flight")
    assert "antigravity" not in sys.modules
