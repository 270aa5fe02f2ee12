"""Set the environment of our processes, read the secrets of a service, and end DDS without the risk of a hang.

Ends a process's DDS participant without the risk of hanging.

The end of a Fast DDS participant waits for a discovery callback that is just running. In the ROS wheels (2.14.5, built
with GCC's libstdc++ 9 or older) that wait spins while holding the very lock that the callback needs: for ever, and
holding Python's interpreter lock too, so that no Python signal handler runs (Fast-DDS, issue 6513). Callbacks run when
other participants come or go, so it happens when a graph stops.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from rclpy.node import Node

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


FOLDER_VARIABLE = "CREDENTIALS_DIRECTORY"
"""Environment variable with the folder."""
PREFIX = "ltm_"
"""`LoadCredential=ltm:/etc/ltm/credentials` gives each file NAME of that folder as ltm_NAME."""


def service_credential(name: str) -> Path | None:
    """The file of the credential `name`: of that very name, else with the prefix; None where the service has none."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder:
        return None
    files = (Path(folder) / given for given in (name, f"{PREFIX}{name}"))
    return next((file for file in files if file.is_file()), None)


def secret(path: Path) -> Path:
    """Return the service's credential with the name of `path` if it has one, else `path`."""
    return service_credential(path.name) or path


SHUTDOWN_CPU_S = 3.0
"""Processor time that leaving the middleware and the interpreter may take; a node of ours needs 0.5 to 0.9 s."""
PATIENCE_S = 3.0
QUIET_S = 0.3
POLL_S = 0.02


def limit_shutdown(cpu_s: float = SHUTDOWN_CPU_S) -> None:
    """From here on this process ends by SIGPROF when it has used `cpu_s` of processor time and is still there.

    For the last act of a process that has finished its work and sent what it had to send. Processor time, because a
    stuck participant spins, and a healthy one on a busy machine waits.
    """
    # The signal's default action needs no lock of the interpreter, which a stuck participant would not give.
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)


def wait_for_quiet(node: Node, patience_s: float = PATIENCE_S) -> bool:
    """Wait until no endpoint has come or gone for a moment: no discovery callback runs then.

    For a process that goes on after its participant. False when others still came and went after `patience_s`.
    """
    deadline = time.monotonic() + patience_s
    last, since = _endpoints(node), time.monotonic()
    while (now := time.monotonic()) < deadline:
        if now - since > QUIET_S:
            return True
        time.sleep(POLL_S)
        if (endpoints := _endpoints(node)) != last:
            last, since = endpoints, time.monotonic()
    return False


def _endpoints(node: Node) -> dict[str, tuple[int, int]]:
    """How many publish and how many listen, by topic."""
    topics = (name for name, _ in node.get_topic_names_and_types())
    return {topic: (node.count_publishers(topic), node.count_subscribers(topic)) for topic in topics}
