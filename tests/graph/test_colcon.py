import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from ltm_ros.launching.graph import NODE_TYPES

REPOSITORY = Path(__file__).parents[2]
SOURCES = ("ltm_core", "ltm_msgs_py", "ltm_ros", "config", "resource", "scripts")
FILES = ("pyproject.toml", "setup.py", "setup.cfg", "package.xml", "README.md")
# What ROS and our own code look up beside the Python packages.
SHARED = (
    "share/ament_index/resource_index/packages/ltm",
    "share/ltm/package.xml",
    "share/ltm/config/fastdds.xml",
    "share/ltm/config/labels.yaml",
    "share/ltm/launch/site.launch.py",
    *(f"lib/ltm/{kind}" for kind in NODE_TYPES),
)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is built, so that no build folder appears in the checkout."""
    target = tmp_path_factory.mktemp("workspace") / "src" / "ltm"
    target.mkdir(parents=True)
    for name in SOURCES:
        shutil.copytree(REPOSITORY / name, target / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy2(REPOSITORY / name, target / name)
    return target


def _tool(command: list[str], folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, cwd=folder, env=os.environ | environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done


def _executable(path: Path) -> bool:
    return path.is_file() and os.access(path, os.X_OK)


@pytest.mark.parametrize(
    "options", [pytest.param([], id="copied"), pytest.param(["--symlink-install"], id="linked", marks=pytest.mark.slow)]
)
def test_colcon_builds_a_package_that_ros_finds(source: Path, tmp_path: Path, options: list[str]) -> None:
    pytest.importorskip("colcon_ros", reason="colcon comes with the extra `dev`")
    colcon = Path(sys.executable).with_name("colcon")
    workspace = tmp_path / "ws"
    shutil.copytree(source.parent, workspace / "src", symlinks=True)
    built = _tool([str(colcon), "build", *options], workspace, COLCON_HOME=str(tmp_path / "home"))
    assert "Finished <<< ltm" in built.stdout
    prefix = workspace / "install" / "ltm"
    assert [name for name in SHARED if not (prefix / name).is_file()] == []
    assert all(_executable(prefix / "lib/ltm" / name) for name in (*NODE_TYPES, "ltm"))
    # As `ros2 run ltm depth` finds and starts it.
    look_up = (
        "import ament_index_python as a; print(a.get_package_prefix('ltm')); import ltm_core, ltm_ros; "
        "print(ltm_core.__file__)"
    )
    environment = {"PYTHONPATH": "", "AMENT_PREFIX_PATH": ""}
    shell = f'. install/setup.sh && cd / && "{sys.executable}" -c "{look_up}"'
    found, module = _tool(["sh", "-c", shell], workspace, **environment).stdout.split()
    assert Path(found) == prefix
    assert Path(module).is_relative_to(workspace)
    run = f'. install/setup.sh && cd / && PATH="{Path(sys.executable).parent}:$PATH" && exec "{prefix}/lib/ltm/depth" '
    run += "--ros-args -p site:=/no/such/site.yaml -p camera:=north"
    ran = subprocess.run(
        ["sh", "-c", run], cwd=workspace, env=os.environ | environment, capture_output=True, text=True, timeout=60
    )
    assert (ran.returncode, "/no/such/site.yaml: cannot be read" in ran.stderr) == (78, True), ran.stderr


def test_wheel_brings_all_that_is_needed(source: Path, tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    copy = tmp_path / "ltm"
    shutil.copytree(source, copy, symlinks=True)
    _tool([*pip, "wheel", ".", "--no-deps", "--no-build-isolation", "-w", str(tmp_path)], copy)
    (wheel,) = tmp_path.glob("ltm-*.whl")
    assert wheel.name.endswith("-py3-none-any.whl")
    packages = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert packages >= {"ltm_core", "ltm_msgs_py", "ltm_ros"}
    assert "tests" not in packages
    prefix = tmp_path / "prefix"
    _tool([*pip, "install", "--no-deps", "--no-index", "--ignore-installed", "--prefix", str(prefix), str(wheel)], copy)
    assert [name for name in SHARED if not (prefix / name).is_file()] == []
    # On PATH only `ltm`: the nodes' names are too common.
    assert [path.name for path in (prefix / "bin").iterdir()] == ["ltm"]
    assert all(_executable(prefix / "lib/ltm" / kind) for kind in NODE_TYPES)
    ours = {path.name for path in (REPOSITORY / "config").rglob("*") if path.is_file()}
    assert {path.name for path in (prefix / "share/ltm/config").rglob("*") if path.is_file()} == ours
