"""Check that imports go one way: ltm_lab -> ltm_ros -> ltm_msgs_py -> ltm_core, no ROS in ltm_core, no cycle between
folders or files. The sources are read, so that imports inside functions count too."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
ROS = {
    "rclpy", "rpyutils", "rosidl_runtime_py", "rosidl_parser", "ament_index_python", "launch", "launch_ros",
    "rosbag2_py", "sensor_msgs", "geometry_msgs", "nav_msgs", "std_msgs", "std_srvs", "diagnostic_msgs",
    "builtin_interfaces", "rosgraph_msgs", "rcl_interfaces", "cv_bridge", "tf2_ros", "rosbags", "mcap_ros2",
}  # fmt: skip
LAB = {"ltm_lab"}
PACKAGES = ("ltm_core", "ltm_msgs_py", "ltm_ros", "ltm_lab")
TOWER = {
    "numpy", "numba", "llvmlite", "scipy", "cv2", "onnxruntime", "rasterio", "pyproj", "pygeomag", "mgrs", "PIL",
    "pillow_heif", "pydantic", "pydantic_core", "yaml", "typer", "rich", "mcap", "zstandard", "lz4", "packaging",
    "httpx", "httpcore", "simplejpeg",
}  # fmt: skip
"""Packages of others that runtime may import: those that `pip install ltm` brings."""
ON_DEMAND = {
    "rerun": "the viewer",
    "tokenizers": "prompts for networks of text",
    "prometheus_client": "the health node",
    "paho": "the link to a region's map",
    "cryptography": "certificates of that link",
    "pyretechnics": "fires, by an interpreter of its own",
    "rosbags": "SQLite bags",
    "pyarrow": "archives worked again",
    "jinja2": "reports of the demo and of fires",
    "av": "RTSP streams",
}
NOT_ON_A_TOWER = {
    *("rerun", "jinja2", "tokenizers", "pyretechnics", "rosbags", "pyarrow"),
}
"""Of those on demand; all else is in the package that `make deb` builds."""


def imported(nodes: Iterable[ast.AST], package: str) -> Iterator[str]:
    """Whole names of all modules that nodes of a source import; `package`: what a relative import starts from. Of
    `from a.b import c` both a.b and a.b.c, since c may be a module."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or "" if node.level == 0 else ".".join(filter(None, (package, node.module)))
            yield from (base, *(f"{base}.{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Call) and called(node) in ("import_module", "__import__"):
            yield from (a.value for a in node.args if isinstance(a, ast.Constant))


def called(node: ast.Call) -> str:
    """The last name of what is called."""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def modules(top: str) -> dict[str, Path]:
    files = sorted((REPOSITORY / top).rglob("*.py"))
    assert len(files) > 5
    return {".".join(f.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


def within(module: str, places: set[str]) -> bool:
    return any(module == place or module.startswith(f"{place}.") for place in places)


@cache
def product() -> frozenset[tuple[str, str]]:
    """Return each module of the product with each name that it imports."""
    return frozenset(
        (module, name)
        for top in ("ltm_core", "ltm_msgs_py", "ltm_ros")
        for module, path in modules(top).items()
        for name in imported(ast.walk(parsed(path)), module.rpartition(".")[0])
    )


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("ltm_core", ROS | {"ltm_msgs_py", "ltm_ros", "ltm_lab"}),
        ("ltm_msgs_py", {"ltm_ros", "ltm_lab"}),
        ("ltm_ros", {"ltm_lab"}),
    ],
)
def test_nothing_imports_upwards(package: str, forbidden: set[str]) -> None:
    upwards = {
        f"{path.relative_to(REPOSITORY)} imports {name}"
        for path in modules(package).values()
        for name in imported(ast.walk(parsed(path)), package)
        if name.partition(".")[0] in forbidden
    }
    assert not upwards


def test_the_product_never_imports_the_laboratory() -> None:
    crossing = {f"{module} imports {name}" for module, name in product() if within(name, LAB)}
    assert not crossing


def test_the_product_imports_no_package_that_it_does_not_install() -> None:
    own = {"ltm_core", "ltm_msgs_py", "ltm_ros", ""}
    allowed = TOWER | set(ON_DEMAND) | ROS | own | set(sys.stdlib_module_names)
    strangers = {f"{m} imports {n}" for m, n in product() if n.partition(".")[0] not in allowed}
    assert not strangers


def test_what_a_tower_imports_is_in_its_package() -> None:
    """Each kind of camera that a site file may name has to work there, without a network to fetch what it needs."""
    lock = (REPOSITORY / "packaging/requirements.lock").read_text(encoding="utf-8")
    locked = set(re.findall(r"^([a-z0-9.-]+)==", lock, re.MULTILINE))
    assert len(locked) > 100
    distributions = packages_distributions()
    missing = [
        package
        for package in sorted(TOWER | set(ON_DEMAND) - NOT_ON_A_TOWER)
        if locked.isdisjoint(name.lower().replace("_", "-") for name in distributions[package])
    ]
    assert missing == []


def test_nodes_load_nothing_that_only_reports_need() -> None:
    """What is really loaded, whoever imports it: also through packages of others."""
    nodes = [path.stem for path in (REPOSITORY / "ltm_ros/nodes").glob("[a-z]*.py") if path.stem != "viewer"]
    assert len(nodes) > 5
    code = f"""
import importlib, sys
import ltm_ros.launching.runner
for node in ("capture", "health", "recorder", "source", "uplink"):
    importlib.import_module(f"ltm_ros.nodes.{{node}}")
print(*("first." + name for name in sys.modules), sep="\\n")
for node in {nodes}:
    importlib.import_module(f"ltm_ros.nodes.{{node}}")
print(*sys.modules, sep="\\n")
"""
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    study = {"matplotlib", "jinja2", "torch", "mitsuba", "skimage", "onnx", "rosbags", "rerun"}
    study |= {"pyarrow"}
    assert not {name for name in loaded if within(name, LAB | study)}
    # Those that trace, label and weigh nothing do without what costs up to a third of a second and 70 MB a process.
    heavy = ("numba", "scipy.spatial", "scipy.special", "scipy.ndimage", "scipy.interpolate", "rasterio", "onnxruntime")
    absent = {f"first.{name}" for name in heavy}
    assert not {name for name in loaded if within(name, absent)}


def running(tree: ast.Module) -> Iterator[ast.AST]:
    """All nodes but those for the type checker only, which are never run."""
    ahead: list[ast.AST] = [tree]
    while ahead:
        node = ahead.pop()
        yield node
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            ahead += node.orelse
        else:
            ahead += ast.iter_child_nodes(node)


def test_no_modules_import_each_other() -> None:
    """Nor in a circle: imports inside functions, which hide one, count too."""
    files = {name: path for top in PACKAGES for name, path in modules(top).items()}
    graph: dict[str, set[str]] = {}
    for module, path in files.items():
        names = set(imported(running(parsed(path)), module.rpartition(".")[0])) & files.keys()
        # `from a.b import c` needs of a.b, where c is a module, no more than that it is a package.
        graph[module] = {name for name in names if not any(other.startswith(f"{name}.") for other in names)}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


FACADE = {"ltm_core", "ltm_core.camera", "ltm_core.dem", "ltm_core.grid", "ltm_core.pose"}
"""Modules that only hand on public names: they lie on top of all folders of `ltm_core`."""


def folders() -> dict[str, set[str]]:
    """Return each folder of the packages with the other folders that its files import."""
    files = {name: path for top in PACKAGES for name, path in modules(top).items() if name not in FACADE}
    folder = {n: n if p.name == "__init__.py" else n.rpartition(".")[0] for n, p in files.items()}
    graph: dict[str, set[str]] = {}
    for module, path in files.items():
        names = set(imported(running(parsed(path)), module.rpartition(".")[0])) & files.keys()
        graph.setdefault(folder[module], set()).update(folder[name] for name in names)
    return {name: needed - {name} for name, needed in graph.items()}


def test_no_folders_import_each_other() -> None:
    try:
        TopologicalSorter(folders()).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_algorithms_do_not_know_the_site_file() -> None:
    above = {"ltm_core.site", "ltm_core.pipeline"}
    reading = {name for name, needed in folders().items() if name.startswith("ltm_core.") and needed & above}
    assert reading <= above
