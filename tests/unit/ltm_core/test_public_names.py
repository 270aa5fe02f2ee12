import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import ltm_core

PATHS = {
    "ltm_core.dem": ["Dem"],
    "ltm_core.grid": ["GridGeometry"],
    "ltm_core.camera": ["Camera"],
    "ltm_core.pose": ["Pose"],
    "ltm_core.tracing": ["TerrainTracer", "RangeImage"],
    "ltm_core.vision.segmenter": ["Segmenter"],
}


def test_every_public_name_can_be_imported() -> None:
    assert 15 <= len(ltm_core.__all__) <= 25
    assert all(getattr(ltm_core, name).__name__ == name for name in ltm_core.__all__)


def test_the_type_checker_sees_the_same_names() -> None:
    tree = ast.parse(Path(ltm_core.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    stated = {a.name: f"{n.module}" for n in block.body if isinstance(n, ast.ImportFrom) for a in n.names}
    assert stated.keys() == set(ltm_core.__all__)
    assert all(getattr(ltm_core, name).__module__ == module for name, module in stated.items())


@pytest.mark.parametrize(("module", "names"), PATHS.items())
def test_module_paths_of_the_design_keep_working(module: str, names: list[str]) -> None:
    for name in names:
        assert getattr(importlib.import_module(module), name) is getattr(ltm_core, name)


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import ltm_core, sys; print([m for m in ('numba', 'rasterio', 'cv2', 'scipy') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_an_unknown_name_is_an_error() -> None:
    with pytest.raises(AttributeError, match="Tracer"):
        _ = ltm_core.Tracer  # type: ignore[attr-defined]
