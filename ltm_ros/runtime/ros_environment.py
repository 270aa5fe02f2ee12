"""Environment variables of our ROS processes: transport profile, discovery range, threads. The user's settings win."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, MutableMapping
from pathlib import Path

import ltm_ros
from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path

# Fast DDS 2 (Jazzy) reads the first, Fast DDS 3 the second.
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
MAX_DOMAIN = 232

_BOOTSTRAP_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def checked_domain(domain_id: int) -> int:
    """Raises ConfigError: DDS ports of domains above 232 do not fit into 16 bits."""
    if not 0 <= domain_id <= MAX_DOMAIN:
        raise ConfigError(f"ROS domain {domain_id}: take one from 0 to {MAX_DOMAIN}")
    return domain_id


def available_cores() -> int:
    return len(os.sched_getaffinity(0))


def thread_limits(busy: bool, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Thread variables of a node, less those that are set: half the cores for one that computes much, else one."""
    threads = max(1, available_cores() // 2) if busy else 1
    return {name: str(threads) for name in THREAD_VARIABLES if not environ.get(name)}


def ros_environment(
    base: Mapping[str, str] | None = None, *, domain_id: int | None = None, busy: bool | None = None
) -> dict[str, str]:
    """A copy of `base` (default: this process's environment) completed for a ROS process of ours.

    `busy` bounds the thread pools of numerical libraries (`thread_limits`), so that the nodes of a machine do not fight
    for its cores. Only `domain_id` replaces what is already there. Raises ConfigError for a domain out of range.
    """
    environment = dict(os.environ if base is None else base)
    if domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(checked_domain(domain_id))
    environment.setdefault("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment.setdefault("PYTHONUNBUFFERED", "1")
    # Pydantic looks for plug-ins of its own in all that is installed, at each start: 0.07 s of some 1.2.
    environment.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    if not any(environment.get(name) for name in PROFILE_VARIABLES):
        for name in PROFILE_VARIABLES:
            environment[name] = str(config_path("fastdds.xml"))
    if not environment.get("AMENT_PREFIX_PATH") and (Path(sys.prefix) / "share/ament_index").is_dir():
        environment["AMENT_PREFIX_PATH"] = sys.prefix
    if busy is not None:
        environment |= thread_limits(busy, environment)
    _make_importable(environment)
    _renew_bootstrap(environment)
    return environment


def ros_additions(environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Only what `ros_environment` adds to `environ` or changes in it."""
    return {name: value for name, value in ros_environment(environ).items() if environ.get(name) != value}


def apply_to_process(domain_id: int | None = None, environ: MutableMapping[str, str] = os.environ) -> None:
    """Complete this process's own environment. Before the first `rclpy.init`: Fast DDS reads its file only once."""
    environ.update(ros_environment(environ, domain_id=domain_id))


def _make_importable(environment: dict[str, str]) -> None:
    """From a checkout that is not installed, a child finds our packages only when told where they are."""
    root = str(Path(ltm_ros.__file__).resolve().parents[1])
    if Path(root).name in ("site-packages", "dist-packages"):
        return
    paths = [path for path in environment.get("PYTHONPATH", "").split(os.pathsep) if path]
    if root not in paths:
        environment["PYTHONPATH"] = os.pathsep.join([root, *paths])


def _renew_bootstrap(environment: dict[str, str]) -> None:
    """The ROS wheels set LD_LIBRARY_PATH and leave a mark; in an environment inherited from another venv it lies."""
    if _BOOTSTRAP_GUARD not in environment:
        return
    library_paths = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    if str(Path(sys.prefix) / "lib") not in library_paths:
        del environment[_BOOTSTRAP_GUARD]
