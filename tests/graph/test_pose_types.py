from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSPresetProfiles
from scenes.waiting import wait_for

from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Topic
from ltm_ros.runtime.outlet_node import OutletNode

pytestmark = pytest.mark.graph

NAMED = Topic("/odom", PoseWithCovarianceStamped, counted=False, any_pose=True)


def test_a_best_effort_driver_of_another_type_is_heard(ros_domain: int) -> None:
    context, taken = rclpy.Context(), list[Any]()
    rclpy.init(context=context)
    given = {"context": context, "parameter_overrides": [Parameter("site", value="site.yaml")]}
    node = OutletNode(NodeType("taker", NodeConfig, Handler), given)
    driver = rclpy.create_node("driver", context=context)
    publisher = driver.create_publisher(Odometry, NAMED.name, QoSPresetProfiles.SENSOR_DATA.value)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        node.listen(NAMED, taken.append)

        def arrived() -> bool:
            node.state_listeners()
            node.look_at_wiring()
            publisher.publish(Odometry())
            executor.spin_once(timeout_sec=0.1)
            return bool(taken)

        wait_for(arrived, "an Odometry")
        assert isinstance(taken[0], Odometry)
    finally:
        executor.shutdown()
        driver.destroy_node()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
