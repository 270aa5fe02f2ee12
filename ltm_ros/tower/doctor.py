"""Run the checks of `ltm doctor`: what is installed, what is in use and what is missing."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import subprocess  # nosec B404 # argument lists, no shell
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path

from packaging.requirements import Requirement

import ltm_core
from ltm_core.base.errors import LtmError
from ltm_core.base.numba_cache import use_own_cache
from ltm_ros.launching import shared_memory
from ltm_ros.runtime.ros_environment import PROFILE_VARIABLES, available_cores, ros_environment
from ltm_ros.tower.health_client import DoctorFinding, DoctorState

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


def examine(site: Path | None = None) -> list[DoctorFinding]:
    """Run all checks, in the order in which a user would fix them. `site`: the tower's file. Default: the installed
    one, if any."""
    return [
        *check_python(),
        *check_packages(),
        *check_ros(),
        *check_transport(),
        *check_shared_memory(),
        *check_models(),
        *check_machine(),
        *check_tower(site),
    ]


def as_json(findings: list[DoctorFinding]) -> str:
    return json.dumps({"ok": healthy(findings), "findings": [asdict(finding) for finding in findings]}, indent=2)


def healthy(findings: list[DoctorFinding]) -> bool:
    """Return whether nothing required is missing."""
    return not any(finding.state is DoctorState.MISSING for finding in findings)


def summed_up(findings: list[DoctorFinding]) -> list[DoctorFinding]:
    """Merge the working packages of one area into one line."""
    lines: list[DoctorFinding] = []
    for finding in findings:
        if not finding.area.startswith("packages") or finding.state is not DoctorState.OK:
            lines.append(finding)
            continue
        part = f"{finding.name} {finding.detail}"
        if lines and (lines[-1].area, lines[-1].state, lines[-1].name) == (finding.area, DoctorState.OK, ""):
            lines[-1] = DoctorFinding(finding.area, "", DoctorState.OK, f"{lines[-1].detail}, {part}")
        else:
            lines.append(DoctorFinding(finding.area, "", DoctorState.OK, part))
    return lines


def requirements() -> dict[str, list[Requirement]]:
    """Return the project's requirements by extra, "" for the basic ones, from the installed package or the checkout."""
    source = Path(ltm_core.__file__).resolve().parents[1] / "pyproject.toml"
    by_extra: dict[str, list[Requirement]] = {"": []}
    if source.is_file():
        project = tomllib.loads(source.read_text(encoding="utf-8"))["project"]
        groups: dict[str, list[str]] = {"": project["dependencies"], **project.get("optional-dependencies", {})}
        return {extra: [Requirement(line) for line in lines] for extra, lines in groups.items()}
    for line in importlib.metadata.requires("ltm") or []:
        requirement = Requirement(line)
        extras = [e for e in importlib.metadata.metadata("ltm").get_all("Provides-Extra") or [] if f'"{e}"' in line]
        by_extra.setdefault(extras[0] if extras else "", []).append(requirement)
    return by_extra


def check_python() -> Iterator[DoctorFinding]:
    version, remedy = ".".join(map(str, sys.version_info[:3])), "install Python 3.11 or newer, then `make demo`"
    fine = sys.version_info >= (3, 11)
    yield DoctorFinding.judged("python", "Python", fine, f"{version} in {sys.prefix}", remedy, DoctorState.MISSING)


def check_packages() -> Iterator[DoctorFinding]:
    for extra, needed in requirements().items():
        for requirement in needed:
            if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
                continue
            area = f"packages [{extra}]" if extra else "packages"
            absent = DoctorState.OPTIONAL if extra else DoctorState.MISSING
            if extra == "ros" and _distribution(requirement.name) is None:
                # The ROS part checks what is present instead, because it may come from apt.
                continue
            yield _package(area, requirement, absent)


def _package(area: str, requirement: Requirement, absent: DoctorState) -> DoctorFinding:
    version = _distribution(requirement.name)
    remedy = f"{INSTALL} '{requirement.name}{requirement.specifier}'"
    if version is None:
        return DoctorFinding(area, requirement.name, absent, "not installed", remedy)
    if not requirement.specifier.contains(version, prereleases=True):
        return DoctorFinding(area, requirement.name, absent, f"{version}, needed {requirement.specifier}", remedy)
    return DoctorFinding(area, requirement.name, DoctorState.OK, version)


def _distribution(name: str) -> str | None:
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
    place = Path(spec.origin).parent
    wheel = _distribution("ros-jazzy-rclpy")
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
    yield _participant(environment)


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


def _participant(environment: Mapping[str, str]) -> DoctorFinding:
    """Start ROS in a process of its own."""
    area, name, wanted = "transport", "participant", environment["RMW_IMPLEMENTATION"]
    remedy = f"unset RMW_IMPLEMENTATION; {INSTALL} 'ltm[ros]'"
    try:
        ran = subprocess.run(  # nosec B603 # no shell, no argument from the wire
            [sys.executable, "-c", _START], env=dict(environment), capture_output=True, text=True, timeout=60
        )
    except subprocess.TimeoutExpired:
        return DoctorFinding(area, name, DoctorState.MISSING, f"{wanted}: did not start within 60 s")
    if ran.returncode == 0 and (said := ran.stdout.split()):
        return DoctorFinding(area, name, DoctorState.OK, said[-1])
    last = (ran.stderr.strip() or f"exit code {ran.returncode}").splitlines()[-1]
    return DoctorFinding(area, name, DoctorState.MISSING, f"{wanted}: {last}", remedy)


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

    names = shipped_names()
    for name in dict.fromkeys([DEFAULT_MODEL, *names]):
        absent = DoctorState.MISSING if name == DEFAULT_MODEL else DoctorState.OPTIONAL
        try:
            model = OnnxModel(NetworkManifest.find(name))
        except LtmError as error:
            yield DoctorFinding(
                "models", name, absent, str(error), "put the file at the path above, or set LTM_MODEL_PATH"
            )
            continue
        role = " (default)" if name == DEFAULT_MODEL else ""
        told = f"{model.path}{role}, checksum matches its manifest"
        state = "" if model.manifest.output.is_depth else f"; its labels are {known_errors(name).state}"
        yield DoctorFinding("models", name, DoctorState.OK, f"{told}{state}")


def check_machine() -> Iterator[DoctorFinding]:
    area, cores, memory, folder = "machine", available_cores(), _memory_gb(), numba_cache()
    remedy = "assign two cores: nodes wait for each other on one"
    yield DoctorFinding.judged(area, "cores", cores >= 2, f"{cores} for this process", remedy)
    remedy = f"assign {LEAST_MEMORY_GB:.0f} GB, or run fewer cameras with --only"
    yield DoctorFinding.judged(area, "memory", memory >= LEAST_MEMORY_GB, f"{memory:.1f} GB for this process", remedy)
    said = str(folder or "no writable folder: kernels are compiled again at each start")
    yield DoctorFinding.judged(area, "numba cache", folder, said, "export NUMBA_CACHE_DIR=/a/writable/folder")


def check_tower(site: Path | None) -> Iterator[DoctorFinding]:
    """Check the tower of the site file, or the installed one if any."""
    if site is not None or INSTALLED_SITE.exists():
        from ltm_ros.tower.health_client import check_health_port  # reads site files: packages may be missing

        yield from check_health_port(site or INSTALLED_SITE)


def _memory_gb() -> float:
    """Return the memory that this process may use in GB: the machine's, or the container's if that is less."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for limit in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        try:
            text = Path(limit).read_text().strip()
        except OSError:
            continue
        if text.isdigit():
            total = min(total, int(text))
    return total / 1e9


def numba_cache() -> Path | None:
    """Return the folder of numba's compiled kernels, by its own search order; None if none is writable."""
    use_own_cache(Path(ltm_core.__file__).parent)
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    beside = Path(ltm_core.__file__).resolve().parent / "__pycache__"
    fallback = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"
    for folder in [Path(chosen)] if chosen else [beside, fallback]:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None
