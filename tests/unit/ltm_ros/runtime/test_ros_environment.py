import os
import sys
from pathlib import Path

import pytest

import ltm_ros
from ltm_core.base.errors import ConfigError
from ltm_ros.runtime import ros_environment as module
from ltm_ros.runtime.ros_environment import ros_environment


def test_completes_an_empty_environment() -> None:
    environment = ros_environment({}, domain_id=7, busy=False)
    assert environment["ROS_DOMAIN_ID"] == "7"
    assert environment["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    profile = Path(environment["FASTRTPS_DEFAULT_PROFILES_FILE"])
    assert profile.name == "fastdds.xml"
    assert profile.is_file()
    assert environment["FASTDDS_DEFAULT_PROFILES_FILE"] == str(profile)
    assert {environment[name] for name in module.THREAD_VARIABLES} == {"1"}
    assert environment["PYDANTIC_DISABLE_PLUGINS"] == "__all__"


def test_what_the_user_set_stays() -> None:
    given = {
        "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "FASTDDS_DEFAULT_PROFILES_FILE": "/etc/mine.xml",
        "AMENT_PREFIX_PATH": "/opt/ros/jazzy",
        "OMP_NUM_THREADS": "6",
        "PYDANTIC_DISABLE_PLUGINS": "one",
        "ROS_DOMAIN_ID": "3",
    }
    environment = ros_environment(given, busy=True)
    assert given.items() <= environment.items()
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in environment
    assert environment["NUMBA_NUM_THREADS"] == str(max(1, module.available_cores() // 2))
    assert ros_environment(given, domain_id=9)["ROS_DOMAIN_ID"] == "9"


@pytest.mark.parametrize("domain", [-1, 233])
def test_refuses_a_domain_without_ports(domain: int) -> None:
    with pytest.raises(ConfigError, match=f"ROS domain {domain}: give a number from 0 to 232"):
        ros_environment({}, domain_id=domain)


def test_children_find_a_checkout_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    root = str(Path(ltm_ros.__file__).resolve().parents[1])
    assert ros_environment({"PYTHONPATH": "/mine"})["PYTHONPATH"] == os.pathsep.join([root, "/mine"])
    assert ros_environment({"PYTHONPATH": root})["PYTHONPATH"] == root
    monkeypatch.setattr(ltm_ros, "__file__", "/venv/lib/python3.11/site-packages/ltm_ros/__init__.py")
    assert "PYTHONPATH" not in ros_environment({})


def test_bootstrap_of_another_venv_is_done_again() -> None:
    mark = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
    ours = {mark: "1", "LD_LIBRARY_PATH": f"/x:{sys.prefix}/lib"}
    assert ros_environment(ours)[mark] == "1"
    assert mark not in ros_environment({mark: "1", "LD_LIBRARY_PATH": "/other/venv/lib"})
