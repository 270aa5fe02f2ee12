import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bystander import Bystander
from rclpy.qos import qos_profile_sensor_data
from scenes.networks import write_classifier
from scenes.small_site import NAME, SmallSite, apart
from scenes.waiting import wait_for

from ltm_msgs_py.image import image_to_msg
from ltm_ros.launching.graph import Graph, describe, parameters_yaml
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.handler import EX_CONFIG
from ltm_ros.runtime.topics import IMAGE_RAW, POSED_IMAGE, camera_topic

pytestmark = pytest.mark.graph


def test_what_a_node_cannot_work_with_ends_it_with_its_name(
    small_site: SmallSite, ros_domain: int, tmp_path: Path
) -> None:
    site, manifest = f"site:={small_site.path}", write_classifier(tmp_path)
    network = next(tmp_path.glob("*.onnx"))
    network.write_bytes(network.read_bytes() + b"\0")
    cases = {
        ("depth", "camera:=tower", "speed:=3", site): "speed",
        ("segmentation", "camera:=tower", f"model:={manifest}", site): "sha256",
        ("fuel_map", "site:=/nowhere/site.yaml"): "/nowhere/site.yaml",
        ("recorder", "bag:=/nowhere/bag", "topics:=['no topic']", site): "'no topic'",
    }
    started = {
        case: subprocess.Popen(
            [sys.executable, "-m", f"ltm_ros.nodes.{case[0]}", "--ros-args", *_given(case[1:])],
            stderr=subprocess.PIPE,
            text=True,
        )
        for case in cases
    }
    for case, named in cases.items():
        _, errors = started[case].communicate(timeout=120)
        assert started[case].returncode == EX_CONFIG, (case, errors)
        reasons = [line for line in errors.splitlines() if line.startswith(f"{case[0]}: cannot start: ")]
        assert reasons, (case, errors)
        assert named in errors, (case, errors)
        assert "Traceback" not in errors, (case, errors)


def _given(parameters: tuple[str, ...]) -> list[str]:
    return [part for parameter in parameters for part in ("-p", parameter)]


ECHO = """
import json, rclpy
rclpy.init()
node = rclpy.create_node("echo", automatically_declare_parameters_from_overrides=True)
values = {name: p.value for name, p in node.get_parameters_by_prefix("").items()}
values = {n: v if isinstance(v, (bool, int, float, str)) else list(v) for n, v in values.items()}
print(json.dumps({n: [type(v).__name__, v] for n, v in values.items()}))
node.destroy_node()
rclpy.try_shutdown()
"""


def test_ros_reads_what_was_meant(ros_domain: int, tmp_path: Path) -> None:
    values: dict[str, Any] = {
        "flag": True,
        "count": 2**53 + 1,
        "small": 1e-05,
        "large": 1e20,
        "whole": 2.0,
        "word": "on",
        "letter": "y",
        "number": "12",
        "text": "a: 'b' \"c\" # \\ é\nnext",
        "empty": "",
        "numbers": [1.0, 2.5e-07],
        "words": ["n", "1"],
        "flags": [True, False],
        "nested.counts": [1, -2],
    }
    path = tmp_path / "node.yaml"
    path.write_text(parameters_yaml(values), encoding="utf-8")
    command = [sys.executable, "-c", ECHO, "--ros-args", "--params-file", str(path)]
    read = json.loads(subprocess.check_output(command, text=True, timeout=60).splitlines()[-1])
    assert {name: read[name] for name in values} == {n: [type(v).__name__, v] for n, v in values.items()}


CAPTURE = f"/{NAME}/mast/capture"
IMAGES, POSED = (camera_topic(NAME, "mast", topic) for topic in (IMAGE_RAW, POSED_IMAGE))


def test_drivers_and_displays_with_sensor_data_qos_are_served(small_site: SmallSite, ros_domain: int) -> None:
    """A driver that offers best effort only is heard, and a display that asks for no more gets the frames."""
    node = describe(apart(small_site.site), small_site.path).node("mast/capture")
    camera = small_site.site.camera("mast").calibration
    with Runner(Graph(NAME, (node,)), domain_id=ros_domain) as runner, Bystander() as bystander:
        runner.wait_until_ready(120.0)
        driver = bystander.node.create_publisher(IMAGE_RAW.type, IMAGES, qos_profile_sensor_data)
        seen: list[Any] = []
        bystander.node.create_subscription(POSED_IMAGE.type, POSED, seen.append, qos_profile_sensor_data)
        size = camera.camera()
        photo = np.full((size.height, size.width, 3), 90, np.uint8)

        def answered() -> bool:
            photo[0, 0, 0] += 1  # the same image twice counts as repeated
            driver.publish(image_to_msg(photo, "rgb8", time.time_ns(), "mast_optical"))
            return bool(seen)

        wait_for(answered, "a frame of the driver", lambda: bystander.summaries)
        assert (seen[0].width, seen[0].height) == (size.width, size.height)
        wait_for(lambda: bystander.summaries[CAPTURE].get("noted.best_effort") == "1", "word of it")
