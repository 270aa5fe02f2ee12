"""Set the environment of our processes, read the secrets of a service, and end DDS without the risk of a hang.

The end of a Fast DDS participant waits for a running discovery callback. In the ROS wheels (2.14.5, built with GCC's
libstdc++ 9 or older) that wait spins while holding the lock that the callback needs: for ever, and it also holds
Python's interpreter lock, so that no Python signal handler runs (Fast-DDS, issue 6513). Callbacks run when other
participants start or end, so it happens when a graph stops."""

import os
import signal
import sys
import time
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import TYPE_CHECKING

import ltm_ros
from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path

if TYPE_CHECKING:
    from rclpy.node import Node

# Fast DDS 2 (Jazzy) reads the first, Fast DDS 3 the second.
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
MAX_DOMAIN = 232
"""Highest ROS domain: DDS ports of higher ones do not fit into 16 bits."""

_BOOTSTRAP_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def available_cores() -> int:
    return len(os.sched_getaffinity(0))


def thread_limits(busy: bool, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the thread variables of a node that are not set yet: half the cores for a busy node, else one."""
    threads = max(1, available_cores() // 2) if busy else 1
    return {name: str(threads) for name in THREAD_VARIABLES if not environ.get(name)}


def ros_environment(
    base: Mapping[str, str] | None = None, *, domain_id: int | None = None, busy: bool | None = None
) -> dict[str, str]:
    """Return a copy of `base` (default: this process's environment) completed for a ROS process.

    `busy` limits the thread pools of numerical libraries (`thread_limits`), so that nodes do not compete for cores.
    Only `domain_id` replaces an existing value. Raises ConfigError for a domain out of range."""
    environment = dict(os.environ if base is None else base)
    if domain_id is not None:
        if not 0 <= domain_id <= MAX_DOMAIN:
            raise ConfigError(f"ROS domain {domain_id}: give a number from 0 to {MAX_DOMAIN}")
        environment["ROS_DOMAIN_ID"] = str(domain_id)
    environment.setdefault("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment.setdefault("PYTHONUNBUFFERED", "1")
    # Pydantic searches all installed packages for plug-ins at each start: 0.07 of some 1.2 s.
    environment.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    if not any(environment.get(name) for name in PROFILE_VARIABLES):
        for name in PROFILE_VARIABLES:
            environment[name] = str(config_path("fastdds.xml"))
    if not environment.get("AMENT_PREFIX_PATH") and (Path(sys.prefix) / "share/ament_index").is_dir():
        environment["AMENT_PREFIX_PATH"] = sys.prefix
    if busy is not None:
        environment |= thread_limits(busy, environment)
    # For a checkout that is not installed.
    root = str(Path(ltm_ros.__file__).resolve().parents[1])
    paths = [path for path in environment.get("PYTHONPATH", "").split(os.pathsep) if path]
    if Path(root).name not in ("site-packages", "dist-packages") and root not in paths:
        environment["PYTHONPATH"] = os.pathsep.join([root, *paths])
    # In an environment inherited from another venv, the ROS wheels must set LD_LIBRARY_PATH again.
    if str(Path(sys.prefix) / "lib") not in environment.get("LD_LIBRARY_PATH", "").split(os.pathsep):
        environment.pop(_BOOTSTRAP_GUARD, None)
    return environment


def apply_to_process(domain_id: int | None = None, environ: MutableMapping[str, str] = os.environ) -> None:
    """Complete this process's own environment, before the first `rclpy.init`: Fast DDS reads its file only once."""
    environ.update(ros_environment(environ, domain_id=domain_id))


FOLDER_VARIABLE = "CREDENTIALS_DIRECTORY"
"""Environment variable with the folder of credentials."""
PREFIX = "ltm_"
"""`LoadCredential=ltm:/etc/ltm/credentials` provides each file NAME of that folder as ltm_NAME."""


def service_credential(name: str) -> Path | None:
    """Return the file of the credential `name`, without or with the prefix; None if the service has none."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder:
        return None
    files = (Path(folder) / given for given in (name, f"{PREFIX}{name}"))
    return next((file for file in files if file.is_file()), None)


def secret(path: Path) -> Path:
    """Return the service's credential with the name of `path` if it has one, else `path`."""
    return service_credential(path.name) or path


SHUTDOWN_CPU_S = 3.0
"""Processor time in seconds for shutting down the middleware and the interpreter; a node needs 0.5 to 0.9 s."""
PATIENCE_S = 3.0
QUIET_S = 0.3
POLL_S = 0.02


def limit_shutdown(cpu_s: float = SHUTDOWN_CPU_S) -> None:
    """End this process by SIGPROF if it uses `cpu_s` more of processor time.

    For the last step of a process that has finished its work and sent everything. Processor time is used, because a
    stuck participant spins, while a healthy one on a busy machine waits."""
    # The signal's default action needs no interpreter lock, which a stuck participant would hold.
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)


def wait_for_quiet(node: "Node", patience_s: float = PATIENCE_S) -> bool:
    """Wait until endpoints have not changed for a moment, so that no discovery callback runs.

    For a process that continues after its participant. Returns False if they still changed after `patience_s`."""
    deadline = time.monotonic() + patience_s
    last, since = _endpoints(node), time.monotonic()
    while (now := time.monotonic()) < deadline:
        if now - since > QUIET_S:
            return True
        time.sleep(POLL_S)
        if (endpoints := _endpoints(node)) != last:
            last, since = endpoints, time.monotonic()
    return False


def _endpoints(node: "Node") -> dict[str, tuple[int, int]]:
    """Return the numbers of publishers and subscriptions, by topic."""
    topics = (name for name, _ in node.get_topic_names_and_types())
    return {topic: (node.count_publishers(topic), node.count_subscribers(topic)) for topic in topics}
