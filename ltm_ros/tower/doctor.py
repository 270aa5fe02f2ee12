"""Run the checks of `ltm doctor`: what is installed, what is in use and what is missing."""

import contextlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import subprocess  # nosec B404 # argument lists, no shell
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

from packaging.requirements import Requirement

import ltm_core
from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.numba_cache import use_own_cache
from ltm_core.storage.disk_io import require_folder
from ltm_ros.launching import shared_memory
from ltm_ros.runtime.ros_environment import PROFILE_VARIABLES, available_cores, ros_environment

MESSAGE_PACKAGES = (
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
)
SMALLEST_SITE_NODES = 6
"""Number of nodes of a site with one camera, and one to watch them."""
LEAST_MEMORY_GB = 4.0
INSTALL = "pip install"
INSTALLED_SITE = Path("/etc/ltm/site.yaml")


class DoctorState(StrEnum):
    OK = "ok"
    OPTIONAL = "optional"
    """Missing, and needed only by some commands."""
    WARNING = "warning"
    """Works with limitations."""
    MISSING = "missing"
    """Missing, and the system does not work without it."""


@dataclass(frozen=True)
class DoctorFinding:
    area: str
    name: str
    state: DoctorState
    detail: str
    remedy: str = ""
    """Command that fixes it."""

    @classmethod
    def judged(
        cls, area: str, name: str, fine: object, detail: str, remedy: str, bad: DoctorState = DoctorState.WARNING
    ) -> "DoctorFinding":
        """Return a finding that is ok, or has the state `bad` and the remedy."""
        return cls(area, name, DoctorState.OK if fine else bad, detail, "" if fine else remedy)


def examine(site: Path | None = None) -> list[DoctorFinding]:
    """Run all checks, in the order in which a user would fix them. `site`: the tower's file. Default: the installed
    one, if any."""
    return [
        *check_packages(),
        *check_ros(),
        *check_transport(),
        *check_shared_memory(),
        *check_models(),
        *check_machine(),
        *check_tower(site),
    ]


def as_json(findings: list[DoctorFinding]) -> str:
    """Return the findings, and as `ok` whether nothing required is missing."""
    fine = all(finding.state is not DoctorState.MISSING for finding in findings)
    return json.dumps({"ok": fine, "findings": [asdict(finding) for finding in findings]}, indent=2)


def requirements() -> dict[str, list[Requirement]]:
    """Return the requirements of the installed package by extra; "" for the basic ones."""
    by_extra: dict[str, list[Requirement]] = {"": []}
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # a checkout on PYTHONPATH
        package = importlib.metadata.distribution("ltm")
        extras = package.metadata.get_all("Provides-Extra") or []
        for line in package.requires or []:
            extra = next((extra for extra in extras if f'"{extra}"' in line), "")
            by_extra.setdefault(extra, []).append(Requirement(line))
    return by_extra


def check_packages() -> Iterator[DoctorFinding]:
    yield DoctorFinding("python", "Python", DoctorState.OK, f"{platform.python_version()} in {sys.prefix}")
    for extra, needed in requirements().items():
        area, absent = (f"packages [{extra}]", DoctorState.OPTIONAL) if extra else ("packages", DoctorState.MISSING)
        working = []
        for one in needed:
            version = _version(one.name)
            if (one.marker is not None and not one.marker.evaluate({"extra": extra})) or (
                extra == "ros" and version is None  # the ROS part checks what is present, because it may come from apt
            ):
                continue
            if version is not None and one.specifier.contains(version, prereleases=True):
                working.append(f"{one.name} {version}")
                continue
            said = f"{version}, needed {one.specifier}" if version else "not installed"
            yield DoctorFinding(area, one.name, absent, said, f"{INSTALL} '{one.name}{one.specifier}'")
        if working:
            yield DoctorFinding(area, "", DoctorState.OK, ", ".join(working))


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def check_ros() -> Iterator[DoctorFinding]:
    remedy = f"{INSTALL} 'ltm[ros]' (x86-64), or: apt install ros-jazzy-ros-base && source /opt/ros/jazzy/setup.sh"
    spec = importlib.util.find_spec("rclpy")
    if spec is None or spec.origin is None:
        yield DoctorFinding("ros", "rclpy", DoctorState.MISSING, "not found", remedy)
        return
    place, wheel = Path(spec.origin).parent, _version("ros-jazzy-rclpy")
    from_wheels = wheel is not None and place.is_relative_to(sys.prefix)
    kind = f"pip wheel {wheel}" if from_wheels else f"ROS {os.environ.get('ROS_DISTRO', '(unknown distribution)')}"
    yield DoctorFinding("ros", "rclpy", DoctorState.OK, f"{kind}, {place}")
    absent = [name for name in MESSAGE_PACKAGES if importlib.util.find_spec(name) is None]
    said = f"no {', '.join(absent)}" if absent else ", ".join(MESSAGE_PACKAGES)
    yield DoctorFinding.judged("ros", "messages", not absent, said, remedy, DoctorState.MISSING)
    if importlib.util.find_spec("tf2_msgs") is None:
        lacks = "not found: live graphs neither read nor publish /tf; recordings and replays do"
        remedy = "use ROS 2 from apt: apt install ros-jazzy-tf2-msgs (it has no Python package)"
        yield DoctorFinding("ros", "tf2_msgs", DoctorState.OPTIONAL, lacks, remedy)


def check_transport() -> Iterator[DoctorFinding]:
    if importlib.util.find_spec("rclpy") is None:
        return
    environment = ros_environment()
    given = next((name for name in PROFILE_VARIABLES if os.environ.get(name)), None)
    profile = Path(environment[given or PROFILE_VARIABLES[0]])
    fine, origin = profile.is_file(), f"from {given}" if given else "default"
    said = f"{profile} ({origin})" if fine else f"{given}={profile} is not a file"
    yield DoctorFinding.judged("transport", "profile", fine, said, f"unset {given}", DoctorState.MISSING)
    domain, reach = environment.get("ROS_DOMAIN_ID", "0"), environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    yield DoctorFinding("transport", "discovery", DoctorState.OK, f"domain {domain}, range {reach}")
    fine, said = _participant(environment)
    remedy = f"unset RMW_IMPLEMENTATION; {INSTALL} 'ltm[ros]'"
    yield DoctorFinding.judged("transport", "participant", fine, said, remedy, DoctorState.MISSING)


_START = """
import rclpy
from ltm_ros.runtime.ros_environment import limit_shutdown
rclpy.init()
node = rclpy.create_node("ltm_transport_probe", enable_rosout=False)
print(rclpy.get_rmw_implementation_identifier(), flush=True)
limit_shutdown()
node.destroy_node()
rclpy.try_shutdown()
"""


def _participant(environment: Mapping[str, str]) -> tuple[bool, str]:
    """Start ROS in a process of its own; return whether it did, and its middleware or the error."""
    try:
        ran = subprocess.run(  # nosec B603 # no shell, no argument from the wire
            [sys.executable, "-c", _START], env=dict(environment), capture_output=True, text=True, timeout=60
        )
    except subprocess.TimeoutExpired:
        return False, f"{environment['RMW_IMPLEMENTATION']}: did not start within 60 s"
    if ran.returncode == 0 and (said := ran.stdout.split()):
        return True, said[-1]
    last = (ran.stderr.strip() or f"exit code {ran.returncode}").splitlines()[-1]
    return False, f"{environment['RMW_IMPLEMENTATION']}: {last}"


def check_shared_memory() -> Iterator[DoctorFinding]:
    area, folder = "shared memory", str(shared_memory.SHM_FOLDER)
    free = shared_memory.free_bytes()
    if free is None:
        said = "not available: images use UDP, which is slow"
        yield DoctorFinding(area, folder, DoctorState.WARNING, said, "mount -t tmpfs tmpfs /dev/shm")
        return
    fine = free >= shared_memory.BYTES_PER_PARTICIPANT * SMALLEST_SITE_NODES
    said = f"{free >> 20} MB free, enough for {free // shared_memory.BYTES_PER_PARTICIPANT} nodes"
    remedy = "mount -o remount,size=2G /dev/shm, or docker run --shm-size=2g"
    yield DoctorFinding.judged(area, folder, fine, said, remedy)


def check_models() -> Iterator[DoctorFinding]:
    from ltm_core.fuel.label_errors import known_errors
    from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest, shipped_names
    from ltm_core.vision.onnx_model import OnnxModel

    for name in dict.fromkeys([DEFAULT_MODEL, *shipped_names()]):
        absent = DoctorState.MISSING if name == DEFAULT_MODEL else DoctorState.OPTIONAL
        try:
            model = OnnxModel(NetworkManifest.find(name))
        except LtmError as error:
            remedy = "put the file at the path above, or set LTM_MODEL_PATH"
            yield DoctorFinding("models", name, absent, str(error), remedy)
            continue
        role = " (default)" if name == DEFAULT_MODEL else ""
        state = "" if model.manifest.output.is_depth else f"; its labels are {known_errors(name).state}"
        told = f"{model.path}{role}, checksum matches its manifest{state}"
        yield DoctorFinding("models", name, DoctorState.OK, told)


def check_machine() -> Iterator[DoctorFinding]:
    area, cores = "machine", available_cores()
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    with contextlib.suppress(OSError, ValueError):
        memory = min(memory, int(Path("/sys/fs/cgroup/memory.max").read_text()) / 1e9)  # of the container
    remedy = "assign two cores: nodes wait for each other on one"
    yield DoctorFinding.judged(area, "cores", cores >= 2, f"{cores} for this process", remedy)
    remedy = f"assign {LEAST_MEMORY_GB:.0f} GB, or run fewer cameras with --only"
    yield DoctorFinding.judged(area, "memory", memory >= LEAST_MEMORY_GB, f"{memory:.1f} GB for this process", remedy)
    own, given = use_own_cache(Path(ltm_core.__file__).parent), os.environ.get("NUMBA_CACHE_DIR")
    folder = own or Path(given or Path.home() / ".cache/numba")
    try:
        require_folder(folder, "compiled kernels")
        said, fine = str(folder), True
    except ConfigError as error:
        said, fine = f"{error}: kernels are compiled again at each start", False
    yield DoctorFinding.judged(area, "numba cache", fine, said, "export NUMBA_CACHE_DIR=/a/writable/folder")


def check_tower(path: Path | None) -> Iterator[DoctorFinding]:
    """Check the site file, or the installed one if any, and that its tower can answer monitoring systems; it runs
    without that."""
    if path is None and not INSTALLED_SITE.exists():
        return
    # Packages that these need may be missing.
    from ltm_core.site.site_io import load_site
    from ltm_ros.runtime.web_server import bind_error, refusal
    from ltm_ros.tower.health_client import ask

    area, path = "machine", path or INSTALLED_SITE
    try:
        site = load_site(path)
    except LtmError as error:
        yield DoctorFinding(area, "site file", DoctorState.MISSING, str(error), f"ltm check {path}")
        return
    health = site.health
    if health is None or health.port == 0:
        return
    name, place = "health port", f"{health.address}:{health.port}"
    if (taken := bind_error(health.address, health.port)) is None:
        yield DoctorFinding(area, name, DoctorState.OK, f"{place} is free: no tower is running")
        return
    try:
        found = ask(health, "/status.json")["site"]
        other = "" if found == site.name else f"used by the tower of {found}"
    except LtmError as why:
        other = str(why)
    except (TypeError, KeyError):
        other = "another program answers on this port"
    remedy = f"{refusal(health.address, health.port, taken)} of {path}; the tower runs without it, and retries"
    yield DoctorFinding.judged(area, name, not other, other or f"{site.name} answers on {place}", remedy)
