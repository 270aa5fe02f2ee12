"""Checks behind `ltm doctor`: what is installed, what is in use and what is missing."""

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
from ltm_ros.launching import shared_memory
from ltm_ros.runtime.ros_environment import PROFILE_VARIABLES, available_cores, ros_environment
from ltm_ros.tower.doctor_finding import Condition, Finding

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
"""Nodes of a site with one camera, and one to watch them."""
LEAST_MEMORY_GB = 4.0
INSTALL = "pip install"
INSTALLED_SITE = Path("/etc/ltm/site.yaml")


def examine(site: Path | None = None) -> list[Finding]:
    """Everything, in the order in which a person would mend it. `site`: the tower's file; by default the installed
    one, where there is one."""
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


def as_json(findings: list[Finding]) -> str:
    return json.dumps({"ok": healthy(findings), "findings": [asdict(finding) for finding in findings]}, indent=2)


def healthy(findings: list[Finding]) -> bool:
    """Whether nothing required is missing."""
    return not any(finding.state is Condition.MISSING for finding in findings)


def summed_up(findings: list[Finding]) -> list[Finding]:
    """The same with the packages of one area that are as they should be in one line."""
    lines: list[Finding] = []
    for finding in findings:
        if not finding.area.startswith("packages") or finding.state is not Condition.OK:
            lines.append(finding)
            continue
        part = f"{finding.name} {finding.detail}"
        if lines and (lines[-1].area, lines[-1].state, lines[-1].name) == (finding.area, Condition.OK, ""):
            lines[-1] = Finding(finding.area, "", Condition.OK, f"{lines[-1].detail}, {part}")
        else:
            lines.append(Finding(finding.area, "", Condition.OK, part))
    return lines


def requirements() -> dict[str, list[Requirement]]:
    """The project's requirements by extra; under "" those that it always has. Of the installed package, else of the
    checkout."""
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


def check_python() -> Iterator[Finding]:
    version = ".".join(map(str, sys.version_info[:3]))
    fine = sys.version_info >= (3, 11)
    yield Finding(
        "python",
        "Python",
        Condition.OK if fine else Condition.MISSING,
        f"{version} in {sys.prefix}",
        "" if fine else "install Python 3.11 or newer, then `make demo`",
    )


def check_packages() -> Iterator[Finding]:
    for extra, needed in requirements().items():
        for requirement in needed:
            if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
                continue
            area = f"packages [{extra}]" if extra else "packages"
            absent = Condition.OPTIONAL if extra else Condition.MISSING
            if extra == "ros" and _distribution(requirement.name) is None:
                # The ROS part looks at what there is instead: it may come from apt.
                continue
            yield _package(area, requirement, absent)


def _package(area: str, requirement: Requirement, absent: Condition) -> Finding:
    version = _distribution(requirement.name)
    remedy = f"{INSTALL} '{requirement.name}{requirement.specifier}'"
    if version is None:
        return Finding(area, requirement.name, absent, "not installed", remedy)
    if not requirement.specifier.contains(version, prereleases=True):
        return Finding(area, requirement.name, absent, f"{version}, needed {requirement.specifier}", remedy)
    return Finding(area, requirement.name, Condition.OK, version)


def _distribution(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def check_ros() -> Iterator[Finding]:
    remedy = f"{INSTALL} 'ltm[ros]' (x86-64), or: apt install ros-jazzy-ros-base && source /opt/ros/jazzy/setup.sh"
    spec = importlib.util.find_spec("rclpy")
    if spec is None or spec.origin is None:
        yield Finding("ros", "rclpy", Condition.MISSING, "not found", remedy)
        return
    place = Path(spec.origin).parent
    wheel = _distribution("ros-jazzy-rclpy")
    from_wheels = wheel is not None and place.is_relative_to(sys.prefix)
    kind = f"pip wheel {wheel}" if from_wheels else f"ROS {os.environ.get('ROS_DISTRO', 'of unknown distribution')}"
    yield Finding("ros", "rclpy", Condition.OK, f"{kind}, {place}")
    absent = [name for name in MESSAGE_PACKAGES if importlib.util.find_spec(name) is None]
    if absent:
        yield Finding("ros", "messages", Condition.MISSING, f"no {', '.join(absent)}", remedy)
    else:
        yield Finding("ros", "messages", Condition.OK, ", ".join(MESSAGE_PACKAGES))


def check_transport() -> Iterator[Finding]:
    if importlib.util.find_spec("rclpy") is None:
        return
    environment = ros_environment()
    given = next((name for name in PROFILE_VARIABLES if os.environ.get(name)), None)
    profile = Path(environment[given or PROFILE_VARIABLES[0]])
    if profile.is_file():
        yield Finding("transport", "profile", Condition.OK, f"{profile} ({f'from {given}' if given else 'our own'})")
    else:
        yield Finding("transport", "profile", Condition.MISSING, f"{given}={profile} is no file", f"unset {given}")
    domain, reach = environment.get("ROS_DOMAIN_ID", "0"), environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    yield Finding("transport", "discovery", Condition.OK, f"domain {domain}, range {reach}")
    yield _participant(environment)


def _participant(environment: Mapping[str, str]) -> Finding:
    """Start a real one and ask it."""
    wanted = environment["RMW_IMPLEMENTATION"]
    command = [sys.executable, "-m", "ltm_ros.launching.transport_probe"]
    try:
        ran = subprocess.run(  # nosec B603 # no shell, no argument from the wire
            command, env=dict(environment), capture_output=True, text=True, timeout=60
        )
    except subprocess.TimeoutExpired:
        return Finding("transport", "participant", Condition.MISSING, f"{wanted}: did not start within 60 s")
    lines = [line for line in ran.stdout.splitlines() if line.startswith("{")]
    if ran.returncode != 0 or not lines:
        last = (ran.stderr.strip() or ran.stdout.strip() or f"exit code {ran.returncode}").splitlines()[-1]
        return Finding(
            "transport",
            "participant",
            Condition.MISSING,
            f"{wanted}: {last}",
            f"unset RMW_IMPLEMENTATION; {INSTALL} 'ltm[ros]'",
        )
    answer = json.loads(lines[-1])
    largest = max(answer["segment_bytes"], default=0)
    if answer["rmw"] != "rmw_fastrtps_cpp":
        return Finding("transport", "participant", Condition.OK, f"{answer['rmw']}: configure it for images yourself")
    if largest < 32 << 20:
        detail = f"shared memory of {largest / 1e6:.1f} MB: too small for images, some will be lost"
        return Finding(
            "transport",
            "participant",
            Condition.WARNING,
            detail,
            "enlarge /dev/shm (see below), unset profile variables",
        )
    return Finding(
        "transport", "participant", Condition.OK, f"{answer['rmw']}, shared memory of {largest / 1e6:.0f} MB and UDP"
    )


def check_shared_memory() -> Iterator[Finding]:
    free = shared_memory.free_bytes()
    if free is None:
        yield Finding(
            "shared memory",
            str(shared_memory.SHM_FOLDER),
            Condition.WARNING,
            "not there: images go over UDP, slowly",
            "mount -t tmpfs tmpfs /dev/shm",
        )
        return
    needed = shared_memory.BYTES_PER_PARTICIPANT * SMALLEST_SITE_NODES
    nodes = free // shared_memory.BYTES_PER_PARTICIPANT
    yield Finding(
        "shared memory",
        str(shared_memory.SHM_FOLDER),
        Condition.OK if free >= needed else Condition.WARNING,
        f"{free >> 20} MB free, enough for {nodes} nodes",
        "" if free >= needed else "mount -o remount,size=2G /dev/shm, or docker run --shm-size=2g",
    )
    seen = shared_memory.survey()
    yield Finding(
        "shared memory",
        "segments",
        Condition.WARNING if seen.stale else Condition.OK,
        f"{seen.segments_in_use} in use, {len(seen.stale)} objects of dead processes ({seen.stale_bytes >> 20} MB)",
        "fastdds shm clean (`ltm run` also does it)" if seen.stale else "",
    )


def check_models() -> Iterator[Finding]:
    from ltm_core.vision.label_confidence import doubt_of_photographs, load_calibration
    from ltm_core.vision.manifest import DEFAULT_MODEL, Manifest, shipped_names
    from ltm_core.vision.onnx_model import OnnxModel

    names = shipped_names()
    for name in dict.fromkeys([DEFAULT_MODEL, *names]):
        absent = Condition.MISSING if name == DEFAULT_MODEL else Condition.OPTIONAL
        try:
            model = OnnxModel(Manifest.find(name))
        except LtmError as error:
            yield Finding(
                "models", name, absent, str(error), "put the file where it was looked for, or set LTM_MODEL_PATH"
            )
            continue
        role = " (default)" if name == DEFAULT_MODEL else ""
        told = f"{model.path}{role}, checksum as its manifest states"
        doubt = "" if model.manifest.output.is_depth else doubt_of_photographs(load_calibration(model.manifest))
        yield Finding("models", name, Condition.OK, f"{told}; its labels were {doubt} here" if doubt else told)


def check_machine() -> Iterator[Finding]:
    cores = available_cores()
    yield Finding(
        "machine",
        "cores",
        Condition.OK if cores >= 2 else Condition.WARNING,
        f"{cores} for this process",
        "" if cores >= 2 else "give it two: nodes wait for each other on one",
    )
    memory = _memory_gb()
    yield Finding(
        "machine",
        "memory",
        Condition.OK if memory >= LEAST_MEMORY_GB else Condition.WARNING,
        f"{memory:.1f} GB for this process",
        "" if memory >= LEAST_MEMORY_GB else f"give it {LEAST_MEMORY_GB:.0f} GB, or run fewer cameras with --only",
    )
    folder = numba_cache()
    yield Finding(
        "machine",
        "numba cache",
        Condition.OK if folder else Condition.WARNING,
        str(folder) if folder else "no writable folder: kernels are compiled anew at each start",
        "" if folder else "export NUMBA_CACHE_DIR=/a/writable/folder",
    )


def check_tower(site: Path | None) -> Iterator[Finding]:
    """Of the site's file, else of the installed one, where there is one."""
    if site is not None or INSTALLED_SITE.exists():
        from ltm_ros.tower.health_client import check_health_port  # reads site files: packages may be missing

        yield from check_health_port(site or INSTALLED_SITE)


def _memory_gb() -> float:
    """What this process may take: the machine's, or the container's where that is less."""
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
    """The folder in which numba keeps compiled kernels: its own order of search; None where none is writable."""
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
